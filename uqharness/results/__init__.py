"""One definition of each result: what is printed, stored, read again and described by a schema."""

DOCUMENTS: dict[str, str] = {
    "bounds": "identification:Bounds",
    "campaign-area": "campaign:Areas",
    "campaign-check": "campaign:CampaignCost",
    "campaign-convergence": "campaign:Convergence",
    "campaign-merge": "campaign:Merged",
    "campaign-report": "campaign:CampaignPage",
    "campaign-rerun": "campaign:Rerun",
    "campaign-run": "campaign:CampaignRun",
    "campaign-salvage": "campaign:Salvaged",
    "campaign-status": "campaign:CampaignStatus",
    "campaign-verify": "campaign:FolderCheck",
    "completion": "folders:CompletionScript",
    "dossier": "folders:DossierFile",
    "log-export": "logs:Playback",
    "log-import": "logs:ImportedLog",
    "log-info": "logs:LogContents",
    "log-map": "logs:ProposedMap",
    "next-flight": "next_flight:NextFlightPlan",
    "next-flight-redone": "next_flight:AchievedNarrowing",
    "refine": "refinement:Refinement",
    "report": "folders:ReportFile",
    "sensitivity": "sensitivity:CampaignSensitivity",
    "sensitivity-modal": "sensitivity:ModalSensitivity",
}
"""Command, with "-" for blanks, to the model of its document, ``module:Class``."""
