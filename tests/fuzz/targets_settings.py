"""Files that a user writes by hand: maps, cards, effects, campaigns, studies."""

from __future__ import annotations

from pathlib import Path

from tests.fuzz.damage_tree import json_damage, toml_damage
from tests.fuzz.formats import Format, folder
from tests.fuzz.outcome import call, command


def _map(place: Path, seed: int) -> None:
    command("log", "info", str(place / "table.csv"), "--no-cache", "--map", str(place / "map.toml"))


def _card(place: Path, seed: int) -> None:
    """The two readers of a card: that of logs and that of aircraft."""
    if seed % 2:
        command(
            "log",
            "info",
            str(place / "flight.bin"),
            "--no-cache",
            "--aircraft",
            str(place / "dart" / "airframe.toml"),
        )
    else:
        from uqharness.simulator.aircraft import find_aircraft

        call(find_aircraft, place / "dart")


def _effects(place: Path, seed: int) -> None:
    from sysid.effects.catalogue import read_effects

    call(read_effects, place / "effects.toml")


def _campaign(place: Path, seed: int) -> None:
    """Reading, and what is worked out from the settings before anything flies."""

    def plan() -> None:
        from uqharness.campaign.cost import epistemic_count, size_of
        from uqharness.campaign.read_spec import read_campaign
        from uqharness.campaign.rounds import rule_of
        from uqharness.campaign.sampling import epistemic_samples

        spec = read_campaign(place / "campaign.toml")
        rule_of(spec.as_dict(), 4)
        size_of(spec)
        # More are refused or asked about before any is made.
        if epistemic_count(spec) <= 10_000:
            epistemic_samples(spec)

    call(plan)


def _study(place: Path, seed: int) -> None:
    from uqharness.study.spec import read_chain

    call(read_chain, place / "study.toml")


_DART = folder("aircraft/dart", "dart")
_CAMPAIGN = {
    **_DART,
    "script.xml": "aircraft/script.xml",
    "model-form.json": "results/bounds/model-form.json",
    "fit.json": "results/fit/fit.json",
}

FORMATS = (
    Format(
        "signal-map",
        ({"map.toml": "settings/map.toml", "table.csv": "logs/table.csv"},),
        ("map.toml",),
        toml_damage,
        _map,
    ),
    Format(
        "card",
        ({**_DART, "flight.bin": "logs/flight.bin"},),
        ("dart/airframe.toml",),
        toml_damage,
        _card,
    ),
    Format(
        "effects",
        ({"effects.toml": "settings/effects.toml"},),
        ("effects.toml",),
        toml_damage,
        _effects,
        0.3,
    ),
    Format(
        "campaign",
        tuple(
            {**_CAMPAIGN, "campaign.toml": f"settings/{name}.toml"}
            for name in ("campaign", "sampled", "steady")
        ),
        ("campaign.toml",),
        toml_damage,
        _campaign,
    ),
    Format(
        "campaign-inputs",
        ({**_CAMPAIGN, "campaign.toml": "settings/sampled.toml"},),
        ("model-form.json", "fit.json"),
        json_damage,
        _campaign,
    ),
    Format(
        "study",
        ({**_CAMPAIGN, "study.toml": "settings/study.toml"},),
        ("study.toml",),
        toml_damage,
        _study,
    ),
)
"""Signal maps, cards, effects, campaigns (and the model form and the fit that one names),
studies.
"""
