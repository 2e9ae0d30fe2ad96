"""Evidence of a folder by NASA-STD-7009's factors of credibility. No level is given: that is for those who use the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from uqharness.dossier.evidence import STUDY, Evidence, Step
from uqharness.dossier.match import FAIL, PASS, UNSURE, Match

STANDARD = "NASA-STD-7009B"
NOT_ASSESSED = "not assessed"
ENGINE_CHECK = "engine-check.csv"


@dataclass(frozen=True)
class Factor:
    """A factor, what it is about, and what the folder holds of it; no evidence is "not assessed"."""

    name: str
    about: str
    evidence: tuple[str, ...]


def factors(found: Evidence, match: Match) -> tuple[Factor, ...]:
    """The eight factors with the folder's evidence."""
    return tuple(Factor(name, about, tuple(says(found, match))) for name, about, says in _FACTORS)


def flown_by_simulation(found: Evidence) -> list[str]:
    """Aircraft that flew a study's flights in place of a real one."""
    stages = [
        s for study in found.of(STUDY) for s in _document(study)["stages"] if s["kind"] == "fly"
    ]
    return list(
        dict.fromkeys(
            words[2] for s in stages if len(words := (s.get("command") or "").split()) > 2
        )
    )


def _data(found: Evidence, _: Match) -> list[str]:
    said = []
    for aircraft in flown_by_simulation(found):
        said.append(
            f"the flights are simulated, by the model {aircraft}: none is of a real aircraft"
        )
    for step in found.of("identify"):
        digests = _document(step).get("flights_sha256") or []
        names = ", ".join(_document(step)["flights"])
        with_digest = "with SHA-256" if digests else "without a digest"
        said.append(f"{_at(step)}: identified from {names}, recorded {with_digest}")
        noise = {c: row.get("noise") for c, row in _document(step)["fit"].items()}
        known = sum(value is not None for value in noise.values())
        said.append(f"{_at(step)}: sensor noise estimated for {known} of {len(noise)} channels")
    for step in found.of("refine"):
        train, test = (
            ", ".join(_document(step).get(k, ())) or "not recorded" for k in ("train", "test")
        )
        said.append(f"{_at(step)}: effects chosen on {train}, shown on the hold-out flights {test}")
    return said


def _verification(found: Evidence, _: Match) -> list[str]:
    # Imported here: a folder without a campaign needs none of it.
    from uqharness.campaign.folder import read_check

    said = []
    for step in found.of("campaign"):
        rows = read_check(step.folder)
        if not rows and (step.folder / ENGINE_CHECK).is_file():
            found.say(f"{_at(step)}: {ENGINE_CHECK} cannot be read")
        if rows:
            alike = sum(row.verdict == "alike" for row in rows)
            excused = sum(row.verdict == "excused" for row in rows)
            flights = len({row.case_id for row in rows})
            said.append(
                f"{_at(step)}: {flights} flights flown by a second engine as well; of {len(rows)} metrics {alike} are alike, "
                f"{excused} excused with a reason, {len(rows) - alike - excused} differ (engine-check.csv)"
            )
    for step in found.of("identify"):
        converged = "converged" if _document(step).get("converged") else "did not converge"
        said.append(f"{_at(step)}: the estimation {converged}")
    return said


def _validation(found: Evidence, match: Match) -> list[str]:
    said = []
    counts = {
        answer: sum(j.answer == answer for j in match.judged) for answer in (PASS, FAIL, UNSURE)
    }
    if match.judged:
        said.append(
            f"proof of match: {len(match.judged)} segments judged by objective tests, {counts[PASS]} pass, {counts[FAIL]} fail, "
            f"{counts[UNSURE]} inconclusive; {len(match.missing)} tests are not in the data"
        )
    for step in found.of("refine"):
        test = _document(step)["gap"]["test"]
        # In turbulence replays hold what the gusts did, and predictions judge.
        predicted = test.get("predictions") or {}
        rows = predicted or test["channels"]
        ratios = {
            c: r["rms_after"] / r["noise_rms"]
            for c, r in rows.items()
            if r.get("rms_after") and r.get("noise_rms")
        }
        if ratios:
            worst = max(ratios, key=lambda c: ratios[c])
            whose = "rms of one-step predictions" if predicted else "rms"
            said.append(
                f"{_at(step)}: on the hold-out flights {whose} over noise is at most {ratios[worst]:.2f} ({worst})"
            )
    for step in found.of("compare"):
        reached = "reaches" if _document(step)["reached_noise_floor"] else "does not reach"
        said.append(
            f"{_at(step)}: the model {reached} the noise floor on {_document(step)['flight']}"
        )
    return said


def _inputs(found: Evidence, _: Match) -> list[str]:
    said = []
    for step in found.of("campaign"):
        hashes = _document(step).get("hashes") or {}
        if hashes:
            said.append(f"{_at(step)}: SHA-256 recorded of {', '.join(sorted(hashes))}")
        air = _document(step)["campaign"]["aleatory"]
        said.append(
            f"{_at(step)}: wind {_list(air['wind_mps'])} m/s, turbulence {_list(air['turbulence'])} (Dryden, source "
            f"{air['turbulence_source']}); no measured air"
        )
    return said


def _uncertainty(found: Evidence, _: Match) -> list[str]:
    said = []
    for step in found.of("identify"):
        rows = _document(step)["parameters"].values()
        sure = sum(r["status"] == "identified" for r in rows)
        rest = "" if sure == len(rows) else f"; {len(rows) - sure} are not identified"
        said.append(f"{_at(step)}: standard errors of {sure} of {len(rows)} parameters{rest}")
    for step in found.of("bounds"):
        said.append(
            f"{_at(step)}: intervals of the model's error for {len(_document(step).get('coefficients', {}))} coefficients at "
            f"{100 * _document(step).get('confidence', 0.95):g} % as functions of the flight state"
        )
    for step in found.of("validate-bounds"):
        shares = {c: row["0.95"] for c, row in _document(step)["coverage"].items()}
        low, high = min(shares.values()), max(shares.values())
        said.append(
            f"{_at(step)}: {100 * low:.1f} to {100 * high:.1f} % of a new flight's samples lie inside the 95 % intervals"
        )
    for step in found.of("campaign"):
        cases = _document(step).get("cases", "?")
        said.append(
            f"{_at(step)}: p-boxes: epistemic uncertainty by intervals, aleatory uncertainty by {cases} flights"
        )
    return said


def _robustness(found: Evidence, _: Match) -> list[str]:
    said = []
    for step in found.of("campaign"):
        if (step.folder / "sensitivity.csv").is_file():
            said.append(
                f"{_at(step)}: share of each coefficient in the width of every p-box (sensitivity.csv)"
            )
        epistemic = _document(step)["campaign"]["epistemic"]
        inner = epistemic.get("interior")
        beside = f", {inner} samples between them" if inner else ""
        said.append(f"{_at(step)}: epistemic samples by {epistemic['method']}{beside}")
    return said


def _none(_: Evidence, __: Match) -> list[str]:
    return []


_FACTORS: Sequence[tuple[str, str, Callable[[Evidence, Match], list[str]]]] = (
    ("Data pedigree", "data that the model was made from", _data),
    ("Verification", "the model is computed as it is written", _verification),
    ("Validation", "the model against the aircraft", _validation),
    ("Input pedigree", "data that the model was used with", _inputs),
    ("Uncertainty characterisation", "sources of uncertainty in the results", _uncertainty),
    ("Results robustness", "sensitivity of the results", _robustness),
    ("Use history", "earlier use of the model for the same purpose", _none),
    ("People", "qualification of those who made and used the model", _none),
)


def _document(step: Step) -> dict[str, Any]:
    return dict(step.document or {})


def _at(step: Step) -> str:
    return step.kind if step.place == "." else step.place


def _list(value: object) -> str:
    return ", ".join(str(v) for v in value) if isinstance(value, (list, tuple)) else str(value)
