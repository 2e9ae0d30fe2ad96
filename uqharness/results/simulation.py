"""Results about simulated models: flights, modes, margins, differences, the plugin."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from uqharness.results.authoring import ModelDifference
from uqharness.results.base import Number, Numbers, Part, Texts


class GainsTaken(Part):
    """Gains of a parameter file."""

    taken: dict[str, float] = Field(description="property to value, in the property's unit")
    ignored: dict[str, str] = Field(description="parameter of these loops to why it was not taken")
    others: int = Field(description="number of parameters of other functions")


_GAINS = "gains taken from the parameter file; null without one"


class FlownMissionItem(Part):
    """One item of a mission of waypoints."""

    number: int = Field(description="number of the item in the file")
    kind: str = Field(description="leg, loiter, turns, time, to-altitude or home")
    from_s: float = Field(description="when it began, s")
    to_s: float = Field(description="when it was complete, or the flight ended, s")
    complete: bool = Field(description="whether it was flown to its end")
    cross_track_median_m: Number = Field(description="median distance from leg or circle, m")
    cross_track_max_m: Number = Field(description="largest distance, m")


class FlownFlight(Part):
    """One flight (`uqharness fly`)."""

    status: Literal["ok", "diverged", "ground-contact", "crashed", "timeout"] = Field(
        description="ok, or what ended the flight early"
    )
    reason: str = Field(description="why it ended early; empty otherwise")
    flown_s: float = Field(description="time flown, s")
    rows: int = Field(description="rows of the record")
    out: str | None = Field(description="file of the record; null if none was written")
    left_out: Texts = Field(description="columns that the file's format cannot hold")
    autopilot: GainsTaken | None = Field(default=None, description=_GAINS)
    mission_items: list[FlownMissionItem] = Field(
        default=[], description="items of a mission of waypoints"
    )


class EigenvalueInterval(Part):
    """A mode over members of a model form."""

    real: tuple[Number, Number] = Field(
        description="interval of the real part, 1/s; null if no member has it"
    )
    wn_radps: tuple[Number, Number] = Field(description="interval of the natural frequency, rad/s")
    zeta: tuple[Number, Number] = Field(description="interval of the damping ratio")
    share: float = Field(
        description="share of the members that have the mode as a pair or as real roots, as the"
        " nominal model has it"
    )
    unstable: float = Field(description="share of the members in which a root of this name grows")


class Eigenvalue(Part):
    """A mode of the linear model."""

    name: str = Field(
        description="short_period, phugoid, third (oscillation between two real roots), dutch_roll,"
        " roll, spiral or other (coupled roll-spiral); every eigenvalue once"
    )
    real: float = Field(description="real part, 1/s")
    imag: float = Field(description="imaginary part, 1/s")
    wn_radps: float = Field(description="natural frequency, rad/s")
    zeta: Number = Field(description="damping ratio")
    interval: EigenvalueInterval | None = Field(
        default=None, description="over members of the model form; absent without one"
    )


class AssessedLevel(Part):
    """A criterion of MIL-F-8785C."""

    mode: str = Field(description="mode that it judges")
    criterion: str = Field(description="quantity")
    value: Number = Field(description="its value; null if undefined or infinite")
    unit: str = Field(description="its unit")
    level: int = Field(description="1 to 3; 4: worse than Level 3")
    paragraph: str = Field(description="paragraph of the specification")


class Modes(Part):
    """Trim, modes and Levels (`uqharness modes`)."""

    trim: Numbers | None = Field(
        description="V_mps, alpha_deg, beta_deg, theta_deg, climb_deg, turn_rate_degps, each"
        " control as NAME_UNIT, elevator_deg and throttle_pct, v_north_mps, v_east_mps, v_down_mps,"
        " thrust_N, rpm; null without a steady flight"
    )
    reason: str = Field(
        default="", description="why there is no steady flight; exit code 1; absent otherwise"
    )
    modes: list[Eigenvalue] = Field(description="modes; empty without a steady flight")
    levels: list[AssessedLevel] = Field(
        default=[], description="criteria; absent without a steady flight"
    )
    bounds: str = Field(default="", description="model form of the intervals; absent without one")
    notes: Texts = Field(
        default=[], description="roll that JSBSim's step does not resolve; absent without one"
    )


class MarginsOfLoop(Part):
    """Stability margins of one loop, opened at its controller's output."""

    gain_up_dB: Number = Field(description="factor to instability by more gain, dB; null: none")
    gain_down_dB: Number = Field(description="factor to instability by less gain, dB; null: none")
    phase_deg: Number = Field(description="phase margin, deg")
    delay_s: Number = Field(description="delay margin, s")
    modulus: float = Field(description="smallest distance of the response from -1")
    gain_crossovers_radps: list[float] = Field(description="frequencies of unit gain, rad/s")
    phase_crossovers_radps: list[float] = Field(description="frequencies of phase -180 deg, rad/s")
    not_read_radps: list[float] = Field(
        description="frequencies that no margin is read from, rad/s: the responses of the two signs"
        " of the injection differ by 10 % or more"
    )


class Margins(Part):
    """Stability margins of the autopilot (`uqharness margins`)."""

    flight: Literal["loiter", "straight"] = Field(description="where they were measured")
    loops: dict[str, MarginsOfLoop] = Field(description="margins by actuator")
    autopilot: GainsTaken | None = Field(default=None, description=_GAINS)


class ComparedFlight(Part):
    """A flight of both models."""

    name: str = Field(description="manoeuvre or script")
    frames: int = Field(description="frames that both flew")
    reason: str | None = Field(description="why B did not fly it, or not all of it")
    only_a: Texts = Field(description="channels that only A has")
    only_b: Texts = Field(description="channels that only B has")
    jsbsim_b: str | None = Field(
        default=None, description="version of JSBSim that flew B; null: that of A"
    )


class ChannelDifference(Part):
    """A channel in which two models differ in one flight."""

    channel: str = Field(description="name")
    unit: str = Field(description="unit of the values")
    group: str = Field(default="", description="kind of channel, by which causes are ranked")
    flight: str = Field(description="flight")
    from_s: float = Field(description="time of the first frame beyond equality, s")
    largest: Number = Field(description="largest difference")
    at_s: float = Field(default=0.0, description="its time, s")
    share_of_range: Number = Field(description="largest difference over the channel's range")
    times_benign: Number = Field(
        default=None, description="largest difference over the one that counts as equal"
    )
    a: Number = Field(default=None, description="value of A at that time")
    b: Number = Field(default=None, description="value of B at that time")
    likeliest: Texts = Field(description="model and line of the likeliest causes in the XML")


class DifferentElement(Part):
    """An XML element that differs."""

    path: str = Field(description="place in words")
    a: str | None = Field(description="content in A; null: it has none")
    b: str | None = Field(description="content in B; null: it has none")
    a_where: str | None = Field(description="file and line in A")
    b_where: str | None = Field(description="file and line in B")


class Differences(Part):
    """Differences of two models (`uqharness diff`)."""

    a: str = Field(description="first model")
    b: str = Field(description="second model")
    differ: bool = Field(description="whether they differ; true: exit code 1")
    tolerance: float = Field(description="share of a channel's range that counts as equal")
    flights: list[ComparedFlight] = Field(description="what was flown")
    differences: list[ChannelDifference] = Field(description="the likeliest cause first")
    terms: list[DifferentElement] = Field(description="elements of the XML that differ")


DiffDocument = Differences | ModelDifference
"""What `uqharness diff` prints: of two aircraft, or where a model file is compared."""


class PluginAxes(Part):
    """Axes of the aircraft's aerodynamics."""

    force: str = Field(description="axes of its forces")
    moment: str = Field(description="axes of its moments")


class PluginCoefficient(Part):
    """An increment of a coefficient."""

    coefficient: Literal["CX", "CY", "CZ", "Cl", "Cm", "Cn"] = Field(description="coefficient")
    axis: str = Field(description="axes of the XML that it is added to")
    where: str = Field(description="file and line")


class PluginScale(Part):
    """Scale and bias of a function of the aircraft's XML, which identify can estimate."""

    axis: str = Field(description="axis of the function")
    function: str = Field(description="property of the function")
    file: str = Field(description="file")
    line: int = Field(description="line in it")
    scale: str = Field(description="property of the scale")
    bias: str = Field(description="property of the bias")


class PluginFile(Part):
    """A file of the copy that differs from the original."""

    file: str = Field(description="name within the aircraft's folder")
    change: Literal["edited", "added", "replaced"] = Field(description="what was done")
    lines: int = Field(description="lines of the change")


class PluginCheck(Part):
    """Comparison of the copy with the original in flight."""

    status: Literal["works", "wrong", "fails"] = Field(
        description="works; wrong: the plugin is at fault; fails: the original does not fly"
    )
    reason: str = Field(description="why it does not work")
    properties: int = Field(description="properties compared")
    unsteady: int = Field(description="those that differ between two flights of the original")
    worst: Number = Field(description="largest relative error of an increment")
    dt_s: Number = Field(description="step of the flights, s")


class UndoneFile(Part):
    """A file from which the plugin was removed."""

    file: str = Field(description="name within the aircraft's folder")
    result: str = Field(description="what became of it")


class Plugin(Part):
    """An aircraft with the plugin (`uqharness instrument`)."""

    aircraft: str = Field(description="name")
    out: str = Field(description="folder of the copy")
    written: bool = Field(description="false with --dry-run")
    axes: PluginAxes = Field(description="axes of the aerodynamics")
    coefficients: list[PluginCoefficient] = Field(description="increments")
    scaled: list[PluginScale] = Field(description="functions with scale and bias")
    files: list[PluginFile] = Field(description="files that differ")
    unmeasured: dict[str, str] = Field(
        default={}, description="control to why it could not be measured and is assumed"
    )
    notes: Texts = Field(description="remarks for the user")
    check: PluginCheck | None = Field(
        default=None, description="check flights; absent without them"
    )


class RemovedPlugin(Part):
    """An aircraft without the plugin (`uqharness instrument --undo`)."""

    undone: list[UndoneFile] = Field(description="files that were restored")


PluginOutcome = Plugin | RemovedPlugin
