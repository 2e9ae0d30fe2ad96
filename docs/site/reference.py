"""The reference pages, written from the code: commands from its parser, files from its schemas,
properties from its XML.
"""

from __future__ import annotations

import argparse
import ast
import collections.abc
import dataclasses
import importlib
import json
import re
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import reference_words as words
from lxml import etree
from reference_python import python

from sysid.logs.signal_map import markdown_table
from sysid.model_form.model_form import CoefficientBounds, ModelForm
from uqharness.campaign import CampaignSpec, sensitivity, statements, tables
from uqharness.campaign import rounds as campaign_rounds
from uqharness.campaign import tables as campaign_results
from uqharness.campaign.spec import Document
from uqharness.cli import main as cli
from uqharness.results.base import Part
from uqharness.results.identification import Bounds, Compare, Coverage, Fit
from uqharness.results.next_flight import NextFlightPlan
from uqharness.results.refinement import Refinement
from uqharness.results.study import Study
from uqharness.simulator.aircraft import PROJECT_ROOT, STANDARD, Card

NOTE = "<!-- Written by docs/site/reference.py at every build. -->\n\n"


def pages() -> dict[str, str]:
    """File name -> Markdown of every page."""
    written = {
        "commands.md": commands(),
        "files.md": files(),
        "properties.md": properties(),
        "settings.md": settings(),
    }
    return written | {"python.md": python()}


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    lines += [
        "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) + " |"
        for row in rows
    ]
    return "\n".join(lines) + "\n\n"


# Commands.


def commands() -> str:
    """Every command with its options and examples, as `--help` has them."""
    parser = cli.complete_parser()
    text = (
        NOTE + "# Commands, option by option\n\nWhat `--help` says. What they are for:"
        " [Commands](../commands.md).\n\n"
    )
    return text + "".join(command(leaf) for leaf in leaves(parser))


def leaves(parser: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    """The parsers of all commands, subcommands in place of their parents."""
    subs = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    return [leaf for sub in subs for child in sub.choices.values() for leaf in leaves(child)] or [
        parser
    ]


def command(parser: argparse.ArgumentParser) -> str:
    rows = []
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        name = (
            f"`{', '.join(action.option_strings)}`"
            if action.option_strings
            else f"`{metavar(action)}`"
        )
        if action.option_strings and action.nargs != 0 and action.choices is None:
            name += f" {metavar(action)}"
        told = (
            (action.help or "")
            .replace("%(default)s", str(action.default))
            .replace("%%", "%")
            .replace(str(Path.home()), "~")
        )
        if action.choices is not None:
            told += "; one of " + ", ".join(f"`{choice}`" for choice in action.choices)
        if action.option_strings and action.required:
            told += " (required)"
        rows.append([name, told])
    text = f"## {parser.prog}\n\n{parser.description or ''}\n\n" + table(
        ["argument", "meaning"], rows
    )
    return text + (f"```text\n{parser.epilog.strip()}\n```\n\n" if parser.epilog else "")


def metavar(action: argparse.Action) -> str:
    if isinstance(action.metavar, str):
        return action.metavar
    if action.choices is not None:
        return "{" + ",".join(map(str, action.choices)) + "}"
    return action.dest.upper()


# Files.


def files() -> str:
    """Columns and keys of every file that commands write."""
    text = (
        NOTE
        + "# Files\n\nParquet columns have the type that is named; empty or null means undefined,"
        " never 0.\n\n"
    )
    text += (
        "## Flight record (.csv, .parquet)\n\nOne row a sample; the last columns say where a log's"
        " signal comes from.\n\n"
    )
    text += markdown_table() + "\n\n"
    text += "Of JSBSim the signals are\n\n" + table(
        ["signal", "property", "factor"], jsbsim_sources()
    )
    text += "## cases.parquet\n\nOne row a flight.\n\n" + table(
        ["column", "type", "meaning"], case_rows()
    )
    schema = campaign_results._pbox_table(_no_flights(), 0.95).schema
    text += "## pbox.parquet\n\n" + described([(f.name, str(f.type)) for f in schema], words.PBOX)
    for name, columns, told in (
        (campaign_results.EXCURSIONS, campaign_results._EXCURSION_COLUMNS, words.RATES),
        (statements.STATEMENTS, statements._COLUMNS, words.RATES),
        (campaign_rounds.DECISIONS, campaign_rounds._COLUMNS, words.RATES),
        ("sensitivity.csv", sensitivity.COLUMNS, words.SENSITIVITY),
    ):
        text += f"## {name}\n\n" + described([(column, "") for column in columns], told)
    for name, places, told in DOCUMENTS:
        text += f"## {name}\n\n" + keys(document_keys(*places) if places else list(told), told)
    form = ["format", *(field.name for field in dataclasses.fields(ModelForm))]
    text += "## model-form.json\n\n" + keys(form, words.MODEL_FORM)
    text += "Of each coefficient:\n\n"
    return text + keys(
        [field.name for field in dataclasses.fields(CoefficientBounds)], words.BOUNDS
    )


def fields_of(model: type[Part]) -> dict[str, str]:
    """Meanings of a result's keys."""
    return {f.alias or name: f.description or "" for name, f in model.model_fields.items()}


# File, the functions whose returned dictionaries make it (none: a model's fields), meanings.
DOCUMENTS = (
    (
        "manifest.json",
        (
            "uqharness.campaign.manifest:describe",
            "+tables",
            "+journal",
            "+sums",
            "+digest",
            "+engine",
        ),
        words.MANIFEST,
    ),
    ("fit.json", (), fields_of(Fit)),
    ("compare.json", (), fields_of(Compare)),
    ("bounds.json", (), fields_of(Bounds)),
    ("coverage.json", (), fields_of(Coverage)),
    ("refinement.json", (), fields_of(Refinement)),
    ("next-flight.json", (), fields_of(NextFlightPlan)),
    ("study.json", (), fields_of(Study)),
)


def document_keys(*places: str) -> list[str]:
    """Keys of the dictionaries that functions (`module:function`) return, alone or joined by `|`,
    read from their source.

    `+key` is one that a command adds; the files that the examples leave are held against the whole.
    """
    found: dict[str, None] = {}
    for place in places:
        if place.startswith("+"):
            found[place[1:]] = None
            continue
        module, function = place.split(":")
        tree = ast.parse(
            Path(importlib.import_module(module).__file__ or "").read_text(encoding="utf-8")
        )
        (body,) = [n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == function]
        returned = [
            n.value for n in ast.walk(body) if isinstance(n, ast.Return) and n.value is not None
        ]
        literals = [literal for value in returned for literal in joined(value)]
        assert literals, f"{place} returns no dictionary that is written out"
        found |= dict.fromkeys(
            k.value for literal in literals for k in literal.keys if isinstance(k, ast.Constant)
        )
    return list(found)


def joined(value: ast.expr) -> list[ast.Dict]:
    """The dictionary literals of `{...}`, `a | {...}`."""
    if isinstance(value, ast.BinOp):
        return joined(value.left) + joined(value.right)
    return [value] if isinstance(value, ast.Dict) else []


def keys(found: Sequence[str], told: Mapping[str, str]) -> str:
    """Table of JSON keys. KeyError where code and words differ."""
    extra = set(told) - set(found)
    if extra:
        raise KeyError(
            f"{sorted(extra)} described in docs/site/reference_words.py and written by no code"
        )
    return table(
        ["key", "meaning"], [(f"`{key}`", words.meaning(key, dict(told))) for key in found]
    )


def described(columns: Sequence[tuple[str, str]], told: dict[str, str]) -> str:
    if not any(kind for _, kind in columns):
        return table(
            ["column", "meaning"], [(f"`{name}`", words.meaning(name, told)) for name, _ in columns]
        )
    return table(
        ["column", "type", "meaning"],
        [(f"`{name}`", kind, words.meaning(name, told)) for name, kind in columns],
    )


def case_columns() -> list[tuple[str, str]]:
    """Every column that cases.parquet may have, with its type."""
    more = (*tables.OPTIONAL_METRICS,)
    schema = tables._schema((15.0, 25.0), more, ("level_<property>", "variable_<property>"))
    return [(field.name, str(field.type)) for field in schema]


def case_rows() -> list[tuple[str, str, str]]:
    return [(f"`{name}`", kind, words.meaning(name, words.CASES)) for name, kind in case_columns()]


def _no_flights() -> typing.Any:
    return tables._schema((15.0, 25.0), (), ()).empty_table().to_pandas()


def jsbsim_sources() -> list[tuple[str, str, str]]:
    return [
        (f"`{name}`", f"`{s.property}`" + (f" / `{s.over}`" if s.over else ""), f"{s.factor:g}")
        for name, s in STANDARD.items()
    ]


# Properties.


def properties() -> str:
    """Properties that the aircraft's XML declares, with its own remarks."""
    text = (
        NOTE
        + "# Properties\n\nDeclared in the XML with the value that stands here; a host or a script"
        " may set them.\n\n"
    )
    text += (
        "## The plugin\n\n`<C>` is one of CX CY CZ Cl Cm Cn; see"
        " [instrument](../instrument.md).\n\n"
    )
    text += table(
        ["property", "meaning"], [(f"`{name}`", told) for name, told in words.PROPERTIES.items()]
    )
    folder = PROJECT_ROOT / "aircraft" / "espaaro"
    text += (
        "An aircraft without coefficient properties of its own gets `uq/scale/...` (1) and"
        " `uq/bias/...` (0) for each\n"
    )
    text += "function of its aerodynamics; `uq-instrument.json` in its folder lists them.\n\n"
    for title, path in (
        ("E-SPAARO: coefficients, commands, servos", folder / "espaaro.xml"),
        ("Wind and turbulence", folder / "Systems" / "air.xml"),
        ("Sensors and path", folder / "Systems" / "sensors.xml"),
        ("Autopilot", folder / "Systems" / "autopilot.xml"),
    ):
        rows = [(f"`{name}`", value, remark) for name, value, remark in declared(path)]
        text += f"## {title}\n\nFrom `{path.relative_to(PROJECT_ROOT)}`.\n\n" + table(
            ["property", "value", "remark"], rows
        )
    return text


def declared(path: Path) -> list[tuple[str, str, str]]:
    """(name, value, remark on the same line) of each property that a file declares."""
    found = []
    for element in etree.parse(path).getroot().iter("property"):
        if element.get("value") is None:
            continue
        after = element.getnext()
        same_line = (
            after is not None and after.tag is etree.Comment and "\n" not in (element.tail or "")
        )
        found.append(
            (
                element.text.strip(),
                element.get("value"),
                " ".join(after.text.split()) if same_line else "",
            )
        )
    return found


def plugin_names() -> set[str]:
    """Names, the coefficient as <C>, of what the plugin's XML declares or computes."""
    text = (PROJECT_ROOT / "aircraft" / "espaaro" / "Systems" / "model-form.xml").read_text(
        encoding="utf-8"
    )
    return {
        re.sub(r"uq/C\w/", "uq/<C>/", name) for name in re.findall(r"[>\"](uq/[\w/-]+)[<\"]", text)
    }


# Settings.


def settings() -> str:
    """Keys of campaign.toml and airframe.toml, from the models that validate them."""
    text = (
        NOTE
        + "# Settings\n\nKeys of the files that you write; meanings: [campaigns](../campaigns.md),"
        " [aircraft](../aircraft.md).\n\n"
    )
    assert set(Document.model_fields) <= {field.name for field in dataclasses.fields(CampaignSpec)}
    for title, model in (("campaign.toml", Document), ("airframe.toml", Card)):
        text += f"## {title}\n\n"
        for name, field in model.model_fields.items():
            section = next(
                (t for t in (field.annotation, *parts(field.annotation)) if is_section(t)), None
            )
            if section is None:
                text += f"### {title}: [{name}]\n\nProperties or outputs by name.\n\n"
                continue
            star = f"[{name}.NAME]" if "Mapping" in str(field.annotation) else f"[{name}]"
            text += (
                f"### {title}: {star}\n\n"
                + " ".join((section.__doc__ or "").split()).replace("``", "`")
                + "\n\n"
            )
            text += nested(section) + table(["key", "type", "default"], section_rows(section))
    return text


def is_section(annotation: object) -> bool:
    return hasattr(annotation, "model_fields") or dataclasses.is_dataclass(annotation)


def section_rows(section: typing.Any) -> list[tuple[str, str, str]]:
    """Key, type and default of a section that a model or a data class stands for."""
    if dataclasses.is_dataclass(section):
        return [
            (f"`{key}`", in_words(hint), "") for key, hint in typing.get_type_hints(section).items()
        ]
    return [(f"`{key}`", kind(item), default(item)) for key, item in section.model_fields.items()]


def nested(section: typing.Any) -> str:
    """Tables of the sections within a section."""
    text = ""
    for key, field in getattr(section, "model_fields", {}).items():
        inner = next((t for t in parts(field.annotation) if hasattr(t, "model_fields")), None)
        if inner is not None:
            told = " ".join((inner.__doc__ or "").split()).replace("``", "`")
            rows = [
                (f"`{name}`", kind(item), default(item))
                for name, item in inner.model_fields.items()
            ]
            text += f"`{key}` holds: {told}\n\n" + table(["key", "type", "default"], rows)
    return text


def parts(annotation: object) -> list[object]:
    found: list[object] = []
    for part in typing.get_args(annotation):
        found += [part, *parts(part)]
    return found


_WORDS = {
    float: "number",
    int: "whole number",
    str: "text",
    bool: "true or false",
    typing.Any: "anything",
}
_SIGNS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


def kind(field: typing.Any) -> str:
    """Type of a key in words a TOML author knows, with its limits."""
    return in_words(field.annotation) + limits(field.metadata)


def in_words(annotation: typing.Any) -> str:
    """A Python type as a TOML author would say it."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return in_words(arguments[0]) + limits(arguments[1:])
    if origin is typing.Literal:
        return " or ".join(f'`"{value}"`' for value in arguments)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(in_words(part) for part in arguments if part is not type(None))
    if origin is tuple:
        if not arguments:
            return "list"
        return (
            f"list of {in_words(arguments[0])}"
            if arguments[-1] is ...
            else f"[{', '.join(map(in_words, arguments))}]"
        )
    if origin in (dict, collections.abc.Mapping):
        return f"table of {in_words(arguments[1])}"
    return _WORDS.get(
        annotation,
        "sections, see above" if hasattr(annotation, "model_fields") else str(annotation),
    )


def limits(metadata: Iterable[typing.Any]) -> str:
    """Bounds among the remarks of an annotated type."""
    found = ""
    for item in metadata:
        found += limits(getattr(item, "metadata", ()))
        found += "".join(
            f", {sign} {getattr(item, name):g}"
            for name, sign in _SIGNS.items()
            if hasattr(item, name)
        )
    return found


def default(field: typing.Any) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or value in ({}, (), ""):
        return ""
    return (
        f"`{json.dumps(value)}`"
        if isinstance(value, str | bool | int | float | tuple | list)
        else ""
    )
