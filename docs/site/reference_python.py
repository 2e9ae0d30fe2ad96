"""The reference of the public face: one entry a name, from its docstring."""

from __future__ import annotations

import sysid
import uqharness
from uqharness import sensitivity

CHAPTERS = {
    "Models": ("author", "performance", "export"),
    "Flights": ("find_aircraft", "fly", "read_flights", "export_log", "diff"),
    "Logs": ("log_info", "propose_map"),
    "From flights to a model and its bounds": (
        "identify",
        "compare",
        "fit_model_form",
        "validate_bounds",
        "instrument",
        "refine",
        "next_flight",
    ),
    "Campaigns and p-boxes": (
        "run_campaign",
        "read_campaign",
        "check_campaign",
        "campaign_status",
        "campaign_report",
        "campaign_convergence",
        "campaign_area",
        "merge_campaign",
        "rerun_case",
        "verify",
        "salvage_campaign",
        "check_surrogate",
        "pbox",
        "plot_pbox",
    ),
    "Studies and reports": ("study", "dossier", "report"),
    "Steady flight": ("find_trim", "linearise", "margins"),
    "Errors": ("BadInputError", "LogError"),
}
RESULTS = (
    "uqharness.commands.flights.Flight",
    "uqharness.identification.replay_fit.Identification",
    "uqharness.identification.compare.Comparison",
    "uqharness.identification.bounds.MadeBounds",
    "uqharness.plugin.apply.Instrumented",
    "uqharness.refinement.run.Refinement",
    "uqharness.commands.campaign.CampaignResult",
    "uqharness.campaign.run.Progress",
    "uqharness.statistics.pbox.PBox",
    "uqharness.simulator.trim.Trim",
    "uqharness.simulator.linear.LinearModel",
    "sysid.record.FlightRecord",
)
INTRODUCTION = """# Python, name by name

The docstrings of public names. A test runs every example. For an introduction see
[Python](../python.md).

"""


def python() -> str:
    """The page, in Markdown. KeyError for a public name that no chapter has."""
    placed = {name for names in CHAPTERS.values() for name in names} | {"sensitivity"}
    if placed != set(uqharness.__all__):
        raise KeyError(
            f"in one of CHAPTERS and uqharness alone: {sorted(placed ^ set(uqharness.__all__))}"
        )
    parts = [INTRODUCTION]
    for title, names in CHAPTERS.items():
        parts += [f"## {title}\n\n", *(entry(f"uqharness.{name}") for name in names)]
    parts += ["## What they give\n\n", *(entry(path) for path in RESULTS)]
    for package, title in ((sensitivity, "uqharness.sensitivity"), (sysid, "sysid")):
        names = [
            name
            for name in package.__all__
            if callable(getattr(package, name)) and name not in ("LogError", "FlightRecord")
        ]
        parts += [f"## {title}\n\n", *(entry(f"{package.__name__}.{name}") for name in names)]
    return "".join(parts)


def entry(path: str) -> str:
    """What Sphinx is to write of one name."""
    kind = path.rpartition(".")[2]
    what = (
        "autoexception"
        if kind.endswith("Error")
        else "autoclass"
        if kind[0].isupper()
        else "autofunction"
    )
    members = "   :members:\n" if what == "autoclass" else ""
    return f"```{{eval-rst}}\n.. {what}:: {path}\n{members}```\n\n"
