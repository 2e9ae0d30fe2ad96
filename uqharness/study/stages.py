"""Plan a study: the stages, in order, with the request of each.

`plan` turns a validated study file into a list of `Stage`: the request of one command, the files
that it reads and writes, and what its result depends on. `uqharness.study.run` skips a stage if
inputs, request and outputs are those of the last run.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uqharness.campaign import system_file
from uqharness.errors import BadInputError
from uqharness.identification import parse_designs
from uqharness.requests.base import Request, base_type, command_line, options_of
from uqharness.requests.campaign import RunRequest, SensitivityRequest
from uqharness.requests.identification import (
    BoundsRequest,
    CompareRequest,
    IdentifyRequest,
    ValidateBoundsRequest,
)
from uqharness.requests.logs import LogImportRequest
from uqharness.requests.refinement import RefineRequest
from uqharness.requests.simulation import FlyRequest, InstrumentRequest
from uqharness.simulator import Aircraft, find_aircraft, find_script
from uqharness.study.spec import (
    STAGE_SECTIONS,
    BoundsSection,
    ChainSpec,
    FlySection,
    IdentifySection,
    LogSection,
)
from uqharness.toml import line_of

# Names of the two evaluations of a study: before refinement, and with the refined model.
BEFORE, AFTER = "before", "after"


_KINDS = {"log import": "import", "campaign run": "campaign"}


@dataclass(frozen=True)
class Stage:
    """One command of a study.

    Attributes
    ----------
    name : str
        Unique name in the study, such as ``compare-f1-before``.
    kind : str
        fly, import, instrument, identify, compare, bounds, validate-bounds, campaign, sensitivity
        or refine.
    folder : str
        Folder of the results, relative to the study's.
    request : Request
        What is run.
    inputs : mapping
        Label -> file, or folder of an aircraft, on whose content the result depends.
    outputs : tuple of Path
        Files, or folders of an aircraft, that later stages and the verdict read.
    settings : mapping
        What the result depends on beside request and inputs, as plain JSON types.
    owns : tuple of Path
        What is removed before the stage starts again.
    resumes : bool
        True if the command continues from the files of an interrupted run.
    writes : (Path, mapping) or None
        Path and content of a TOML file that is written before the stage runs (a campaign's).
    belongs : (Path, Path) or None
        Bounds, and the folder of the aircraft that they must have been made for.
    """

    name: str
    kind: str
    folder: str
    request: Request
    inputs: Mapping[str, Path]
    outputs: tuple[Path, ...]
    owns: tuple[Path, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    resumes: bool = False
    writes: tuple[Path, Mapping[str, Any]] | None = None
    belongs: tuple[Path, Path] | None = field(default=None)

    @property
    def command(self) -> str:
        """Return the command line as a shell repeats it."""
        return command_line(self.request, full=True)


@dataclass(frozen=True)
class _Model:
    """The aircraft at one point of the study: its name or path in requests, its folder, and its
    label among the inputs.
    """

    source: str
    folder: Path
    label: str


def plan(spec: ChainSpec, out: Path) -> list[Stage]:
    """Return all stages of a study in the order in which they run.

    Parameters
    ----------
    spec : ChainSpec
        The study file.
    out : Path
        Folder of the study; stages write below it. It need not exist.

    Raises
    ------
    BadInputError
        For aircraft, scripts and files that do not exist, and for options that a stage would
        refuse.
    """
    return list(_Planner(spec, out).stages())


class _Planner:
    """Build the stages of one study; each method builds the stage of one command."""

    def __init__(self, spec: ChainSpec, out: Path) -> None:
        """Find the base aircraft and name the records of all flights."""
        self.spec, self.out = spec, out
        self.base_model = self._aircraft(spec.study.aircraft, "study", "aircraft")
        self.records = {name: out / "flights" / f"{name}.parquet" for name in spec.flights}

    def stages(self) -> Iterator[Stage]:
        """Yield the stages: flights, identification, evaluation, refinement, evaluation."""
        spec, model = self.spec, self.base_model
        # Bounds and campaigns set properties of the plugin; an aircraft without it gets one first.
        if (spec.bounds is not None or spec.campaign is not None) and not _carries_plugin(
            find_aircraft(model.folder)
        ):
            stage = self._instrument(model)
            yield stage
            model = self._model(stage.outputs[0])
        for number, item in enumerate(spec.fly):
            yield self._fly(item, number)
        # A simulated flight is imported as a user's log is.
        logs = {item.name: self.out / "flights" / f"{item.name}.bin" for item in spec.fly}
        for name, log in logs.items():
            yield self._import(name, log, model, None)
        for number, user_log in enumerate(spec.logs):
            yield self._import(
                user_log.name,
                self._file(user_log.file, "logs", number, "file"),
                model,
                user_log,
                number,
            )
        if spec.identify is not None:
            stage = self._identify(spec.identify, model)
            yield stage
            model = self._model(self.out / "identify" / "aircraft")
        # The same evaluation is run before refinement and with the refined model.
        yield from self._evaluation(model, BEFORE)
        if spec.refine is not None:
            stage = self._refine(model)
            yield stage
            yield from self._evaluation(self._model(stage.outputs[1]), AFTER)

    def _evaluation(self, model: _Model, when: str) -> Iterator[Stage]:
        """Yield the stages that are run on both the unrefined and the refined model."""
        spec = self.spec
        if spec.compare is not None:
            for flight in spec.compare.flights:
                yield self._compare(flight, model, when)
        form: Path | None = None
        if spec.bounds is not None:
            stage = self._bounds(spec.bounds, model, when)
            form = stage.outputs[0]
            yield stage
            if spec.bounds.validate_on:
                yield self._validate(spec.bounds.validate_on, form, model, when)
        if spec.campaign is not None:
            stage = self._campaign(model, form, when)
            yield stage
            if (spec.campaign.epistemic.method, spec.campaign.epistemic.set) == ("corners", "box"):
                yield self._sensitivity(stage)

    # One method builds the stage of one command and lists what its result depends on.

    def _instrument(self, model: _Model) -> Stage:
        """Add the plugin to the aircraft."""
        target = self.out / "instrument" / find_aircraft(model.folder).name
        request = InstrumentRequest(aircraft=model.source, out=target, air=self.spec.study.air)
        return self._stage("instrument", target, request, {model.label: model.folder}, [target])

    def _fly(self, item: FlySection, number: int) -> Stage:
        """Simulate one flight of a true aircraft and write its log."""
        out = self.out / "flights" / f"{item.name}.bin"
        truth = self._aircraft(item.aircraft, "fly", number, "aircraft")
        script = self._script(item.script, "fly", number, "script")
        options, files = self._options(item.options, "fly", number)
        request = FlyRequest(
            aircraft=truth.source,
            script=_shell_path(script),
            out=out,
            # Flights of a simulated truth have noise unless the file says otherwise.
            **{"noise": True, **options},
        )
        inputs = {truth.label: truth.folder, f"{item.script} (script)": script, **files}
        return self._stage(f"fly-{item.name}", out.parent, request, inputs, [out], owns=[out])

    def _import(
        self, name: str, log: Path, model: _Model, user_log: LogSection | None, number: int = 0
    ) -> Stage:
        """Convert one log into a record.

        ``user_log`` is its section, or None for a simulated flight; ``number`` is the index of the
        section, for errors.
        """
        out = self.records[name]
        label = self._label(log) if user_log is None else user_log.file
        inputs = {label: log, model.label: model.folder}
        options: dict[str, Any] = {}
        if user_log is not None:
            options, _ = self._options(user_log.options, "logs", number)
            # Optional files of the log's section.
            for key, field_name in (("map", "signal_map"), ("manoeuvres", "manoeuvres")):
                text = getattr(user_log, key)
                if text is not None:
                    path = self._file(text, "logs", number, key)
                    options[field_name] = _shell_path(path)
                    inputs[f"{text} ({key})"] = path
        request = LogImportRequest(
            log=_shell_path(log), aircraft=model.source, out=out, use_cache=False, **options
        )
        return self._stage(f"import-{name}", out.parent, request, inputs, [out], owns=[out])

    def _identify(self, section: IdentifySection, model: _Model) -> Stage:
        """Estimate parameters from flights."""
        out = self.out / "identify"
        options, files = self._options(section.options, "identify")
        request = IdentifyRequest(
            aircraft=model.source,
            flights=self._records(section.flights),
            out=out,
            servos=self.spec.study.servos,
            **options,
        )
        inputs = {model.label: model.folder, **self._flight_inputs(section.flights), **files}
        return self._stage("identify", out, request, inputs, [out / "fit.json", out / "aircraft"])

    def _compare(self, flight: str, model: _Model, when: str) -> Stage:
        """Replay one flight with a model."""
        assert self.spec.compare is not None
        name = f"compare-{flight}-{when}"
        out = self.out / name
        options, files = self._options(self.spec.compare.options, "compare")
        request = CompareRequest(
            aircraft=model.source,
            flight=self._records([flight]),
            out=out,
            servos=self.spec.study.servos,
            **options,
        )
        inputs = {model.label: model.folder, **self._flight_inputs([flight]), **files}
        return self._stage(name, out, request, inputs, [out / "compare.json"])

    def _bounds(self, section: BoundsSection, model: _Model, when: str) -> Stage:
        """Estimate model-form bounds from flights."""
        name = f"bounds-{when}"
        out = self.out / name
        options, files = self._options(section.options, "bounds")
        for option in ("states", "terms"):
            texts = [f"{c}={','.join(names)}" for c, names in options.get(option, {}).items()]
            self._check_designs(option, texts)
        # Every sample counts in the published interval alone.
        if section.samples == "all":
            options["as_published"] = True
        request = BoundsRequest(
            aircraft=model.source,
            flights=self._records(section.flights),
            out=out,
            servos=self.spec.study.servos,
            **options,
        )
        inputs = {model.label: model.folder, **self._flight_inputs(section.flights), **files}
        outputs = [out / "model-form.json", out / "model-form.xml"]
        return self._stage(name, out, request, inputs, outputs)

    def _validate(self, flights: Sequence[str], form: Path, model: _Model, when: str) -> Stage:
        """Check bounds on flights that they were not made from."""
        name = f"validate-{when}"
        out = self.out / name
        request = ValidateBoundsRequest(
            aircraft=model.source,
            form=form,
            flights=self._records(flights),
            out=out,
            servos=self.spec.study.servos,
        )
        inputs = {model.label: model.folder, self._label(form): form} | self._flight_inputs(flights)
        return self._stage(name, out, request, inputs, [out / "coverage.json"])

    def _campaign(self, model: _Model, form: Path | None, when: str) -> Stage:
        """Fly the campaign with one model, and with the bounds of that model if the study makes
        some.
        """
        spec = self.spec
        assert spec.campaign is not None
        name = f"campaign-{when}"
        out, file = self.out / name, self.out / f"{name}.toml"
        data = {section: dict(content) for section, content in spec.campaign_data.items()}
        # Paths inside the study's folder are written relative to it, so that the folder can be
        # moved.
        inside = model.folder.is_relative_to(self.out)
        data["campaign"] |= {
            "aircraft": (
                model.folder.relative_to(self.out).as_posix() if inside else str(model.folder)
            )
        }
        # The aircraft counts by its content, as an input, and not by its path.
        options = {
            **data,
            "campaign": {k: v for k, v in data["campaign"].items() if k != "aircraft"},
        }
        inputs = {model.label: model.folder}
        # A mission script is found relative to the study file.
        if spec.campaign.start is None:
            script = self._script(data["campaign"]["mission"], "campaign", "mission")
            inputs[f"{data['campaign']['mission']} (script)"] = script
            data["campaign"]["mission"] = str(script)
        # Bounds of the study, else those that the file names.
        if form is not None:
            data["epistemic"]["bounds"] = form.relative_to(self.out).as_posix()
            inputs[self._label(form)] = form
        elif isinstance(data["epistemic"].get("bounds"), str):
            bounds_file = self._file(data["epistemic"]["bounds"], "epistemic", "bounds")
            inputs[f"{data['epistemic']['bounds']} (bounds)"] = bounds_file
            data["epistemic"]["bounds"] = str(bounds_file)
        outputs = [
            out / n for n in ("cases.parquet", "pbox.parquet", "excursions.csv", "statements.csv")
        ]
        return self._stage(
            name,
            out,
            # The user has agreed to the campaigns by running the study.
            RunRequest(campaign=file, out=out, yes=True),
            inputs,
            outputs,
            settings=options,
            resumes=True,
            writes=(file, data),
            belongs=None if form is None else (form, model.folder),
        )

    def _sensitivity(self, campaign: Stage) -> Stage:
        """Rank the coefficients of a finished campaign by their share of the p-box width."""
        folder = self.out / campaign.folder
        cases, table = campaign.outputs[0], folder / "sensitivity.csv"
        name = campaign.name.replace("campaign", "sensitivity")
        request = SensitivityRequest(folder=folder)
        return self._stage(
            name, folder, request, {self._label(cases): cases}, [table], owns=[table]
        )

    def _refine(self, model: _Model) -> Stage:
        """Search missing effects on the training flights and check them on the hold-out flights."""
        section = self.spec.refine
        assert section is not None
        out = self.out / "refine"
        options, files = self._options(section.options, "refine")
        request = RefineRequest(
            aircraft=model.source,
            train=self._records(section.train),
            test=self._records(section.test),
            out=out,
            servos=self.spec.study.servos,
            # The study's own campaigns are the p-boxes before and after.
            pbox=self.spec.campaign is None,
            **options,
        )
        flights = self._flight_inputs((*section.train, *section.test))
        inputs = {model.label: model.folder, **flights, **files}
        outputs = [out / "refinement.json", out / "aircraft" / model.folder.name]
        return self._stage("refine", out, request, inputs, outputs, resumes=True)

    def _stage(
        self,
        name: str,
        folder: Path,
        request: Request,
        inputs: Mapping[str, Path],
        outputs: Sequence[Path],
        owns: Sequence[Path] | None = None,
        **more: Any,
    ) -> Stage:
        """Build a stage; ``owns`` defaults to the folder of the results."""
        return Stage(
            name,
            _KINDS.get(request.command, request.command),
            folder.relative_to(self.out).as_posix(),
            request,
            dict(inputs),
            tuple(outputs),
            tuple([folder] if owns is None else owns),
            **more,
        )

    def _options(
        self, options: Mapping[str, Any], *location: str | int
    ) -> tuple[dict[str, Any], dict[str, Path]]:
        """Return options with the paths of files that they name, and these files as inputs."""
        request = STAGE_SECTIONS[str(location[0])][1]
        values, files = dict(options), {}
        for name, (info, field_option) in options_of(request).items():
            if name in values and base_type(info.annotation) is Path:
                key, text = field_option.key or name, str(values[name])
                path = self._file(text, *location, key)
                values[name], files[f"{text} ({key})"] = _shell_path(path), path
        return values, files

    def _records(self, names: Sequence[str]) -> tuple[Path, ...]:
        """Return the records of flights."""
        return tuple(self.records[name] for name in names)

    def _flight_inputs(self, names: Sequence[str]) -> dict[str, Path]:
        """Return label -> record of each flight."""
        return {self._label(self.records[name]): self.records[name] for name in names}

    def _label(self, path: Path) -> str:
        """Return the name of a result: the same wherever the study is run from."""
        return path.relative_to(self.out).as_posix()

    def _model(self, folder: Path) -> _Model:
        """Return the model in a folder of the study."""
        return _Model(str(folder), folder, self._label(folder))

    def _aircraft(self, name: str, *location: str | int) -> _Model:
        """Find an aircraft: a folder relative to the study file, else as every command finds it."""
        local_folder = self.spec.resolve(name)
        try:
            if local_folder.is_dir():
                return _Model(
                    str(_shell_path(local_folder)), find_aircraft(local_folder).folder, name
                )
            return _Model(name, find_aircraft(name).folder, name)
        except BadInputError as error:
            raise self._located_error(error, *location) from None

    def _script(self, name: str, *location: str | int) -> Path:
        """Find a run script: relative to the study file, else as every command finds it."""
        try:
            return find_script(name, self.spec.folder)
        except BadInputError as error:
            raise self._located_error(error, *location) from None

    def _file(self, name: str, *location: str | int) -> Path:
        """Return the path of a file that the study file names; BadInputError if it does not
        exist.
        """
        path = self.spec.resolve(name)
        if not path.is_file():
            raise self._located_error(
                f'"{name}" is no file beside {self.spec.path.name}, in {self.spec.folder}',
                *location,
            )
        return path

    def _check_designs(self, option: str, texts: Sequence[str]) -> None:
        """Parse states or terms now, so that an error is reported before the first stage runs.

        Raises BadInputError at the option's line.
        """
        states, terms = (texts, ()) if option == "states" else ((), texts)
        try:
            parse_designs(states, terms, 2, False)
        except BadInputError as error:
            raise self._located_error(error, "bounds", option) from None

    def _located_error(self, reason: object, *location: str | int) -> BadInputError:
        """Return an error that names file, line, section and key."""
        section = f"[[{location[0]}]]" if isinstance(location[1], int) else f"[{location[0]}]"
        return BadInputError(
            f"{self.spec.path}:{line_of(self.spec.source, location)}: {section} {location[-1]}:"
            f" {reason}"
        )


def _carries_plugin(aircraft: Aircraft) -> bool:
    """Return whether an aircraft has a uq plugin that this version reads."""
    try:
        system_file(aircraft)
    except BadInputError:
        return False
    return True


def _shell_path(path: Path) -> Path:
    """Return a path relative to the working folder if it lies below it, else the absolute path."""
    working_folder, absolute = Path.cwd(), Path(os.path.abspath(path))
    return (
        absolute.relative_to(working_folder)
        if absolute.is_relative_to(working_folder)
        else absolute
    )
