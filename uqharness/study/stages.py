"""Plan a study: the stages, in order, with the command line of each.

`plan` turns a validated study file into a list of `Stage`: the words of one ``uqharness`` command,
the files that it reads and writes, and the settings that its result depends on.
`uqharness.study.run` skips a stage if inputs, settings and outputs are those of the last run.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uqharness.campaign import system_file
from uqharness.errors import BadInputError
from uqharness.identification import parse_designs
from uqharness.requests.identification import IdentifyRequest
from uqharness.simulator import Aircraft, find_aircraft, find_script
from uqharness.study.spec import BoundsSection, ChainSpec, FlySection, IdentifySection, LogSection
from uqharness.toml import line_of

# Names of the two evaluations of a study: before refinement, and with the refined model.
BEFORE, AFTER = "before", "after"


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
    argv : tuple of str
        Words after ``uqharness`` that repeat the stage.
    inputs : mapping
        Label -> file, or folder of an aircraft, on whose content the result depends.
    outputs : tuple of Path
        Files, or folders of an aircraft, that later stages and the verdict read.
    options : mapping
        Settings on which the result depends, as plain JSON types.
    owns : tuple of Path
        What is removed before the stage starts again.
    resumes : bool
        True if the command continues from the files of an interrupted run.
    workers : bool
        True if the command takes ``--workers``, on which no result depends.
    writes : (Path, mapping) or None
        Path and content of a TOML file that is written before the stage runs (a campaign's).
    belongs : (Path, Path) or None
        Bounds, and the folder of the aircraft that they must have been made for.
    """

    name: str
    kind: str
    folder: str
    argv: tuple[str, ...]
    inputs: Mapping[str, Path]
    outputs: tuple[Path, ...]
    options: Mapping[str, Any]
    owns: tuple[Path, ...]
    resumes: bool = False
    workers: bool = False
    writes: tuple[Path, Mapping[str, Any]] | None = None
    belongs: tuple[Path, Path] | None = field(default=None)

    @property
    def command(self) -> str:
        """Return the command line as a shell repeats it."""
        return shlex.join(("uqharness", *self.argv))


@dataclass(frozen=True)
class _Model:
    """The aircraft at one point of the study: its word on command lines, its folder, and its label
    among the inputs.
    """

    word: str
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
            model = _Model(str(stage.outputs[0]), stage.outputs[0], self._label(stage.outputs[0]))
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
        words = [
            "instrument",
            model.word,
            "--out",
            str(target),
            *(["--air"] if self.spec.study.air else []),
        ]
        return self._stage(
            "instrument",
            "instrument",
            target,
            words,
            {model.label: model.folder},
            [target],
            {"air": self.spec.study.air},
        )

    def _fly(self, item: FlySection, number: int) -> Stage:
        """Simulate one flight of a true aircraft and write its log."""
        out = self.out / "flights" / f"{item.name}.bin"
        truth = self._aircraft(item.aircraft, "fly", number, "aircraft")
        script = self._script(item.script, "fly", number, "script")
        # repr of a float repeats it exactly.
        words = ["fly", truth.word, "--script", _shell_path(script), "--seed", str(item.seed)]
        words += ["--turbulence", item.turbulence, "--turbulence-source", item.turbulence_source]
        words += ["--wind-mps", f"{item.wind_mps!r}", "--wind-from-deg", f"{item.wind_from_deg!r}"]
        words += [] if item.duration_s is None else ["--duration-s", f"{item.duration_s!r}"]
        words += ["--rate-hz", f"{item.rate_hz!r}", *(["--noise"] if item.noise else [])]
        for name, value in item.set.items():
            words += ["--set", f"{name}={value!r}"]
        options = item.model_dump(mode="json", exclude={"aircraft", "script"})
        inputs = {truth.label: truth.folder, f"{item.script} (script)": script}
        return self._stage(
            f"fly-{item.name}",
            "fly",
            out.parent,
            [*words, "--out", str(out)],
            inputs,
            [out],
            options,
            owns=[out],
        )

    def _import(
        self, name: str, log: Path, model: _Model, user_log: LogSection | None, number: int = 0
    ) -> Stage:
        """Convert one log into a record.

        ``user_log`` is its section, or None for a simulated flight; ``number`` is the index of the
        section, for errors.
        """
        out = self.records[name]
        words = [
            "log",
            "import",
            _shell_path(log),
            "--out",
            str(out),
            "--aircraft",
            model.word,
            "--no-cache",
        ]
        inputs = {
            self._label(log) if user_log is None else user_log.file: log,
            model.label: model.folder,
        }
        # Optional files of the log's section.
        for option in ("map", "manoeuvres"):
            text = None if user_log is None else getattr(user_log, option)
            if text is not None:
                path = self._file(text, "logs", number, option)
                words += [f"--{option}", _shell_path(path)]
                inputs[f"{text} ({option})"] = path
        return self._stage(
            f"import-{name}", "import", out.parent, words, inputs, [out], {}, owns=[out]
        )

    def _identify(self, section: IdentifySection, model: _Model) -> Stage:
        """Estimate parameters from flights."""
        out = self.out / "identify"
        words = ["identify", model.word, *self._flight_words(section.flights), "--out", str(out)]
        words += [
            "--start",
            section.start,
            "--method",
            section.method,
            "--servos",
            self.spec.study.servos,
        ]
        for option in ("params", "biases", "delays"):
            value = getattr(section, option)
            # Names of channels are checked now; names of parameters need the aircraft and are
            # checked by the command.
            if value is not None and option != "params":
                self._check_option(
                    lambda given: IdentifyRequest.of(aircraft="", flights="flight", **given),
                    {option: value},
                    "identify",
                    option,
                )
            words += [] if value is None else [f"--{option}", ",".join(value) or "none"]
        options = section.model_dump(mode="json") | {"servos": self.spec.study.servos}
        inputs = {model.label: model.folder} | self._flight_inputs(section.flights)
        return self._stage(
            "identify",
            "identify",
            out,
            words,
            inputs,
            [out / "fit.json", out / "aircraft"],
            options,
            workers=True,
        )

    def _compare(self, flight: str, model: _Model, when: str) -> Stage:
        """Replay one flight with a model."""
        name = f"compare-{flight}-{when}"
        out = self.out / name
        words = [
            "compare",
            model.word,
            *self._flight_words([flight]),
            "--servos",
            self.spec.study.servos,
            "--out",
            str(out),
        ]
        inputs = {model.label: model.folder} | self._flight_inputs([flight])
        options = {"servos": self.spec.study.servos}
        return self._stage(
            name, "compare", out, words, inputs, [out / "compare.json"], options, workers=True
        )

    def _bounds(self, section: BoundsSection, model: _Model, when: str) -> Stage:
        """Estimate model-form bounds from flights."""
        name = f"bounds-{when}"
        out = self.out / name
        # Designs as the command line spells them: ``COEFFICIENT=name,name``.
        texts = {
            o: [f"{c}={','.join(names)}" for c, names in getattr(section, o).items()]
            for o in ("states", "terms")
        }
        for option, assignments in texts.items():
            if assignments:
                states, terms = (assignments, []) if option == "states" else ([], assignments)
                self._check_option(
                    lambda pair: parse_designs(pair[0], pair[1], 2, False),
                    (states, terms),
                    "bounds",
                    option,
                )
        words = ["bounds", model.word, *self._flight_words(section.flights), "--out", str(out)]
        words += [
            "--confidence",
            f"{section.confidence!r}",
            "--order",
            str(section.order),
            "--select",
            section.select,
        ]
        # Every sample counts in the published interval alone.
        words += ["--as-published"] if section.samples == "all" else []
        words += ["--outside", section.outside, "--servos", self.spec.study.servos]
        for option in ("cutoff_hz", "airspeed_cutoff_hz", "walk_cutoff_hz"):
            words += [f"--{option.replace('_', '-')}", f"{getattr(section, option)!r}"]
        words += [
            word
            for option, assignments in texts.items()
            for text in assignments
            for word in (f"--{option}", text)
        ]
        words += ["--roll-terms"] if section.roll_terms else []
        words += [] if section.checks else ["--no-check"]
        options = section.model_dump(mode="json", exclude={"validate_on"}) | {
            "servos": self.spec.study.servos
        }
        inputs = {model.label: model.folder} | self._flight_inputs(section.flights)
        outputs = [out / "model-form.json", out / "model-form.xml"]
        return self._stage(name, "bounds", out, words, inputs, outputs, options)

    def _validate(self, flights: Sequence[str], form: Path, model: _Model, when: str) -> Stage:
        """Check bounds on flights that they were not made from."""
        name = f"validate-{when}"
        out = self.out / name
        words = ["validate-bounds", model.word, str(form), *self._flight_words(flights)]
        words += ["--servos", self.spec.study.servos, "--out", str(out)]
        inputs = {model.label: model.folder, self._label(form): form} | self._flight_inputs(flights)
        options = {"servos": self.spec.study.servos, "flights": list(flights)}
        return self._stage(
            name, "validate-bounds", out, words, inputs, [out / "coverage.json"], options
        )

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
        words = ["campaign", "run", str(file), "--out", str(out)]
        outputs = [
            out / n for n in ("cases.parquet", "pbox.parquet", "excursions.csv", "statements.csv")
        ]
        return self._stage(
            name,
            "campaign",
            out,
            words,
            inputs,
            outputs,
            options,
            resumes=True,
            workers=True,
            writes=(file, data),
            belongs=None if form is None else (form, model.folder),
        )

    def _sensitivity(self, campaign: Stage) -> Stage:
        """Rank the coefficients of a finished campaign by their share of the p-box width."""
        folder = self.out / campaign.folder
        cases = campaign.outputs[0]
        return self._stage(
            campaign.name.replace("campaign", "sensitivity"),
            "sensitivity",
            folder,
            ["sensitivity", str(folder)],
            {self._label(cases): cases},
            [folder / "sensitivity.csv"],
            {},
            owns=[folder / "sensitivity.csv"],
        )

    def _refine(self, model: _Model) -> Stage:
        """Search missing effects on the training flights and check them on the hold-out flights."""
        section = self.spec.refine
        assert section is not None
        out = self.out / "refine"
        words = ["refine", model.word]
        for option, names in (("--train", section.train), ("--test", section.test)):
            words += [word for name in names for word in (option, str(self.records[name]))]
        words += ["--servos", self.spec.study.servos, "--out", str(out)]
        # The study's own campaigns are the p-boxes before and after.
        words += [] if self.spec.campaign is None else ["--no-pbox"]
        inputs = {model.label: model.folder} | self._flight_inputs((*section.train, *section.test))
        if section.effects is not None:
            path = self._file(section.effects, "refine", "effects")
            words += ["--effects", _shell_path(path)]
            inputs[f"{section.effects} (effects)"] = path
        options = section.model_dump(mode="json", exclude={"effects"}) | {
            "servos": self.spec.study.servos
        }
        options["pbox"] = self.spec.campaign is None
        outputs = [out / "refinement.json", out / "aircraft" / model.folder.name]
        return self._stage(
            "refine", "refine", out, words, inputs, outputs, options, resumes=True, workers=True
        )

    def _stage(
        self,
        name: str,
        kind: str,
        folder: Path,
        words: Sequence[str],
        inputs: Mapping[str, Path],
        outputs: Sequence[Path],
        options: Mapping[str, Any],
        owns: Sequence[Path] | None = None,
        **stage_options: Any,
    ) -> Stage:
        """Build a stage; paths become relative to the study's folder where they are stored.

        ``owns`` defaults to the folder of the results.
        """
        return Stage(
            name,
            kind,
            folder.relative_to(self.out).as_posix(),
            tuple(words),
            dict(inputs),
            tuple(outputs),
            dict(options),
            tuple([folder] if owns is None else owns),
            **stage_options,
        )

    def _flight_words(self, names: Sequence[str]) -> list[str]:
        """Return ``--flight RECORD`` for each flight."""
        return [word for name in names for word in ("--flight", str(self.records[name]))]

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
                return _Model(_shell_path(local_folder), find_aircraft(local_folder).folder, name)
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

    def _check_option(self, read: Callable[[Any], object], value: object, *location: str) -> None:
        """Parse an option now, so that an error is reported before the first stage runs.

        Raises BadInputError at the option's line.
        """
        try:
            read(value)
        except BadInputError as error:
            raise self._located_error(error, *location) from None

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


def _shell_path(path: Path) -> str:
    """Return a path relative to the working folder if it lies below it, else the absolute path."""
    working_folder, absolute = Path.cwd(), Path(os.path.abspath(path))
    return (
        str(absolute.relative_to(working_folder))
        if absolute.is_relative_to(working_folder)
        else str(absolute)
    )
