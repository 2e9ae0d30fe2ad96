"""Functions of JSBSim compared with their translation: the same XML, the same random arguments,
JSBSim against numpy or compiled code.

``python -m tests.helpers.batch_against`` prints the table of agreement, an operation a line.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tests.helpers import batch_oracle as oracle
from uqharness.batch.ir import Builder, Function, evaluate
from uqharness.batch.maths import lower
from uqharness.batch.translate.frame import Scope
from uqharness.batch.translate.functions import function_value
from uqharness.xml.document import parse_document

A, B, C, F = "<p>i/a</p>", "<p>i/b</p>", "<p>i/c</p>", "<p>i/f</p>"
U = "<p>i/u</p>"  # between -1 and 1
P = "<p>i/p</p>"  # positive
N = "<p>i/n</p>"  # whole, 0 to 3
T, S = "<p>i/t</p>", "<p>i/s</p>"  # truth values
SIX = f"{A}{B}{C}{U}<p>i/u2</p><p>i/u3</p>"

EXACT: Mapping[str, str] = {
    **{
        op: f"<{op}>{A}{B}{C}</{op}>"
        for op in ("sum", "difference", "product", "avg", "min", "max")
    },
    **{
        f"{op} of one": f"<{op}>{A}</{op}>"
        for op in ("sum", "difference", "product", "avg", "min", "max")
    },
    **{
        op: f"<{op}>{A}{B}</{op}>"
        for op in ("quotient", "lt", "le", "gt", "ge", "eq", "nq", "fmod", "roundmultiple")
    },
    **{
        op: f"<{op}>{A}</{op}>"
        for op in (
            "abs",
            "sign",
            "floor",
            "ceil",
            "integer",
            "fraction",
            "toradians",
            "todegrees",
            "sqrt",
        )
    },
    "quotient by 0": f"<quotient>{A}{T}</quotient>",
    "fmod by 0": f"<fmod>{A}{T}</fmod>",
    "roundmultiple of one": f"<roundmultiple>{A}</roundmultiple>",
    "mod": f"<mod><product>{A}<v>100</v></product><sum>{N}<v>1</v></sum></mod>",
    "mod negative": (
        f"<mod><product>{A}<v>100</v></product><difference><v>-1.5</v>{N}</difference></mod>"
    ),
    "and": f"<and>{T}{S}<gt>{A}{B}</gt></and>",
    "or": f"<or>{T}{S}<gt>{A}{B}</gt></or>",
    "and, short": f"<and>{T}<ge>{A}<v>0</v></ge><v>0</v>{A}</and>",
    "not": f"<not>{T}</not>",
    "not near": f"<not><product>{T}<v>1.0000000009</v></product></not>",
    "not half": f"<not><product>{T}<v>0.5</v></product></not>",
    "ifthen": f"<ifthen>{T}{A}{B}</ifthen>",
    "ifthen gt": f"<ifthen><gt>{A}{B}</gt>{A}<v>-3</v></ifthen>",
    "switch": f"<switch>{N}{A}{B}{C}<v>7</v></switch>",
    "switch between": f"<switch><abs>{U}</abs>{A}{B}</switch>",
    "interpolate1d": (
        f"<interpolate1d>{A}<v>-1</v><v>0.3</v><v>0.1</v>{B}<v>1.7</v>{C}</interpolate1d>"
    ),
    "pi": "<product><pi/><v>3</v></product>",
    "property negated": f"<sum><p>-i/a</p>{B}</sum>",
}
"""Operations of IEEE arithmetic alone: bits are the same."""

TRANSCENDENTAL: Mapping[str, str] = {
    **{op: f"<{op}>{A}</{op}>" for op in ("sin", "cos", "tan", "atan", "exp")},
    **{op: f"<{op}>{P}</{op}>" for op in ("ln", "log2", "log10")},
    **{f"{op} of any": f"<{op}>{A}</{op}>" for op in ("ln", "log2", "log10")},
    **{op: f"<{op}>{U}</{op}>" for op in ("asin", "acos")},
    "asin of any": f"<asin>{A}</asin>",
    "sin of 1e6": f"<sin><product>{U}<v>1e6</v></product></sin>",
    "atan2": f"<atan2>{A}{B}</atan2>",
    **{f"pow {e}": f"<pow>{A}<v>{e}</v></pow>" for e in ("2", "3", "4", "-1", "0", "1", "-2", "5")},
    **{f"pow {e}": f"<pow>{P}<v>{e}</v></pow>" for e in ("0.5", "1.5", "0.235")},
    "pow": f"<pow>{P}{B}</pow>",
    "pow whole": f"<pow>{A}{N}</pow>",
    "pow of any": f"<pow>{A}{B}</pow>",
}
"""Operations that call the C library in JSBSim: at most 2 units in the last place apart."""

ROTATIONS: Mapping[str, str] = {
    **{
        f"rotation_{w} {k}": f"<rotation_{w}>{SIX}<v>{k}</v></rotation_{w}>"
        for w in ("bf_to_wf", "wf_to_bf")
        for k in (1, 2, 3)
    },
    **{
        f"rotation_{w}_local": f"<rotation_{w}_local>{SIX}</rotation_{w}_local>"
        for w in ("alpha", "beta", "gamma")
    },
}
"""Sums of products of sines: apart by rounding of the largest term."""


def arguments(rows: int, seed: int = 1) -> dict[str, np.ndarray]:
    """Random inputs, special numbers among them."""
    rng = np.random.default_rng(seed)
    out = {
        name: rng.normal(size=rows) * np.exp2(rng.integers(-3, 4, rows))
        for name in ("i/a", "i/b", "i/c")
    }
    for name in ("i/a", "i/b"):
        out[name][rng.integers(0, rows, rows // 50)] = 0.0
        out[name][rng.integers(0, rows, rows // 50)] = -0.0
        out[name][rng.integers(0, rows, rows // 20)] = rng.integers(-4, 5, rows // 20) * 0.5
    same = rng.integers(0, rows, rows // 20)
    out["i/b"][same] = out["i/a"][same]
    out |= {name: rng.uniform(-1, 1, rows) for name in ("i/u", "i/u2", "i/u3")}
    out["i/p"] = np.exp2(rng.uniform(-60, 60, rows))
    out["i/n"] = rng.integers(0, 4, rows).astype(float)
    out |= {name: rng.integers(0, 2, rows).astype(float) for name in ("i/t", "i/s")}
    return out


def translated(functions: Mapping[str, str], inputs: Mapping[str, np.ndarray]) -> Function:
    """The functions' XML as one lowered function of the intermediate form."""
    builder = Builder()
    outputs = {}
    for name, body in functions.items():
        document = parse_document(Path("functions.xml"), f"<function>{body}</function>".encode())
        scope = Scope(builder, document, lambda p: builder.input(p) if p in inputs else None)
        outputs[name] = function_value(scope, document.root)
    return lower(builder.finish(outputs))


def compared(
    functions: Mapping[str, str], inputs: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """JSBSim's values and ours by name."""
    numbered = {f"o/f{k}": body for k, body in enumerate(functions.values())}
    theirs = oracle.evaluate(numbered, inputs)
    ours, _ = evaluate(translated(functions, inputs), inputs)
    return dict(zip(functions, theirs.values(), strict=True)), ours


def same_bits(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Where the bits are the same, or both are NaN."""
    return (a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))


def ulps(theirs: np.ndarray, ours: np.ndarray) -> np.ndarray:
    """Difference in units of the last place of theirs; infinite where only one is a number."""
    with np.errstate(all="ignore"):
        difference = np.abs(ours - theirs) / np.spacing(np.abs(theirs))
    return np.where(
        same_bits(theirs, ours), 0.0, np.where(np.isfinite(difference), difference, np.inf)
    )


def main() -> None:
    """The table."""
    inputs = arguments(20_000)
    for title, group in (
        ("exact", EXACT),
        ("transcendental", TRANSCENDENTAL),
        ("rotations", ROTATIONS),
    ):
        theirs, ours = compared(group, inputs)
        for name in group:
            share = np.mean(same_bits(theirs[name], ours[name])) * 100
            scale = np.nanmax(np.abs(np.where(np.isfinite(theirs[name]), theirs[name], np.nan)))
            with np.errstate(all="ignore"):
                difference = (
                    np.nanmax(
                        np.where(np.isfinite(theirs[name]), np.abs(theirs[name] - ours[name]), 0)
                    )
                    / scale
                )
            worst = ulps(theirs[name], ours[name]).max()
            print(
                f"{title:15s} {name:25s} {share:8.3f} % same bits, at most {worst:.3g} ulp,"
                f" {difference:.2g} of the largest"
            )


if __name__ == "__main__":
    main()
