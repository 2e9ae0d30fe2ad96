"""What a planned flight starts from: bounds and aircraft of the campaign, the flight as it is simulated, and what to be wary of."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sysid.aerodynamics import Cutoffs, together
from sysid.digests import file_sha256
from sysid.model_form import MissingTerm, ModelForm
from sysid.model_form.missing_terms import missing_terms
from uqharness.errors import BadInputError
from uqharness.next_flight.mission_states import CampaignMission
from uqharness.next_flight.trials import TestFlight, has_autopilot, has_noise, residuals_of
from uqharness.simulator import Aircraft, content_hash, find_aircraft

_BURN_IN_S = 120.0
_ON_AUTOPILOT_S = 4.0


def bounds_of(campaign: CampaignMission, folder: Path, coefficient: str) -> Path:
    """The model form that the campaign in ``folder`` flew. Raises BadInputError for other bounds, saying what to do."""
    if campaign.spec.inputs.model_form is not None:
        return campaign.spec.inputs.model_form
    if not _constant(campaign):
        raise BadInputError(
            f"{folder}: flew the bounds that the aircraft carries; give the model-form.json that they were made from with "
            "--bounds (constant ones tell nothing of where data are lacking)"
        )
    raise BadInputError(
        f"{folder}: flew constant bounds of {coefficient}, which depend on no flight state: nothing says where data are "
        "lacking. Make bounds from flights (uqharness bounds AIRCRAFT --flight FILE --out DIR) and give them with "
        "--bounds DIR/model-form.json"
    )


def _constant(campaign: CampaignMission) -> bool:
    """Whether the campaign file gave its bounds as numbers."""
    return isinstance(campaign.spec.epistemic.bounds, dict)


def aircraft_of(campaign: CampaignMission) -> Aircraft:
    """What is flown: the author's aircraft, but for a trimmed start, whose initial conditions lie in the campaign's copy."""
    own = campaign.spec.start is not None or campaign.mission.source == Path()
    return find_aircraft(campaign.mission.aircraft if own else campaign.mission.source)


def flight_of(
    campaign: CampaignMission, aircraft: Aircraft, form: ModelForm, turbulence: str
) -> TestFlight:
    """The test flight as it is simulated: the mission's script and air of that intensity, recorded at the bounds' rate."""
    held = campaign.spec.start is None and has_autopilot(aircraft)
    begin_s = _ON_AUTOPILOT_S if held else min(float(campaign.spec.aleatory.burn_in_s), _BURN_IN_S)
    steps = max(1, round(1.0 / (min(form.filtering.rate_hz, 60.0) * aircraft.dt_s)))
    return TestFlight(
        aircraft,
        campaign.mission.script,
        held,
        begin_s,
        turbulence,
        has_noise(aircraft),
        1.0 / (steps * aircraft.dt_s),
        campaign.spec.aleatory.turbulence_source,
    )


def missing_in(
    form: ModelForm, aircraft: Aircraft, coefficient: str, flights: Sequence[Path]
) -> list[MissingTerm]:
    """Terms that the flights show to be missing in a coefficient's polynomial. Raises BadInputError."""
    cutoffs = Cutoffs(form.filtering.cutoff_hz, form.filtering.airspeed_cutoff_hz)
    residuals = together(residuals_of(aircraft, flights, cutoffs))
    try:
        return missing_terms(residuals, coefficient, form.coefficients[coefficient])
    except ValueError as error:
        raise BadInputError(f"--flight: {error}") from None


def warnings_of(
    form: ModelForm,
    campaign: CampaignMission,
    flight: TestFlight,
    bounds: Path | None,
    flights: Sequence[Path],
    flown: bool,
) -> list[str]:
    """What makes the plan less certain than it looks, a sentence each.

    Parameters
    ----------
    bounds
        The file of ``form``, None where it is the campaign's own.
    flights
        Files that are said to be those behind the bounds.
    flown
        Whether the mission's flight states come from the campaign's own flights.
    """
    aircraft, out = flight.aircraft, []
    if form.aircraft.sha256 != content_hash(aircraft) and campaign.spec.start is None:
        out.append(
            f"aircraft '{aircraft.name}' has changed since the bounds were made: they belong to the model as it was"
        )
    if not campaign.same_aircraft:
        out.append(
            "the campaign was made by uqharness 0.1: whether its aircraft is as it was cannot be told, nor whether its table is"
        )
    if campaign.spec.inputs.model_form is None:
        kind = (
            "constant ones" if _constant(campaign) else "perhaps: those that the aircraft carries"
        )
        out.append(
            f"the campaign flew other bounds than these ({kind}): which coefficient wins may differ with these"
        )
    elif bounds is not None and bounds.read_bytes() != campaign.spec.inputs.model_form.read_bytes():
        out.append(
            "the campaign flew other bounds than these: which coefficient wins may differ with these"
        )
    known = {f.sha256 for f in form.flights}
    others = [p.name for p in flights if file_sha256(p) not in known]
    if others:
        out.append(
            f"--flight {', '.join(others)}: not among the flights behind the bounds; its scatter may differ"
        )
    if campaign.failed and flown:
        out.append(
            f"{campaign.failed} flights of the campaign failed and do not count for the mission's states"
        )
    if not flight.noise:
        out.append(
            f"aircraft '{aircraft.name}' has no sensors system: the flight was simulated without sensor noise"
        )
    if not flight.has_autopilot:
        out.append(
            f"aircraft '{aircraft.name}' has none of this project's autopilot: test points are steps added to the commands while "
            "the mission is flown, at its speed and bank alone"
        )
    return out
