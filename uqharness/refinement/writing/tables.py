"""A smooth term written as a JSBSim table, under a name that nobody takes for physics."""

from __future__ import annotations

import numpy as np

from sysid.effects import SPANS, Smooth, SmoothFit
from uqharness.plugin import coefficient_reference
from uqharness.refinement.writing.terms import variable_xml
from uqharness.simulator import Aircraft
from uqharness.xml import SectionEdit, add_deltas, add_functions, comment, read_section

GRID = 4 * SPANS + 1
"""Breakpoints: straight lines between four to a span miss a cubic by less than a hundredth of how far it bends in the span."""
PREFIX = "uq/unnamed"


def property_of_table(term: Smooth) -> str:
    """Property that holds the term's value in flight."""
    return f"{PREFIX}/{term.label}"


def write_table(aircraft: Aircraft, fit: SmoothFit) -> None:
    """The term added to an aircraft's aerodynamics, in its own folder. Raises BadInputError."""
    term, name = fit.term, property_of_table(fit.term)
    section = read_section(aircraft.folder, aircraft.xml.name)
    edit = SectionEdit(section)
    state = variable_xml(term.state, section, aircraft)
    key = state.text
    if state.tag != "property":
        # A table looks up a property and no expression.
        key = f"{name}_at"
        edit = add_functions(edit, [f'<function name="{key}">', f"  {state.line()}", "</function>"])
    at = np.linspace(*term.ends, GRID)
    rows = [f"    {x:.8g}  {y:.8g}" for x, y in zip(at, fit.curve(at)[0], strict=True)]
    table = [
        "<table>",
        f'  <independentVar lookup="row">{key}</independentVar>',
        "  <tableData>",
        *rows,
        "  </tableData>",
        "</table>",
    ]
    if term.times:
        factor = variable_xml(term.times, section, aircraft)
        table = ["<product>", *(f"  {line}" for line in table), f"  {factor.line()}", "</product>"]
    remark = (
        f"No physics: a {term.name}, fitted to what no effect of the catalogue explains. Held constant outside "
        f"{at[0]:.4g} to {at[-1]:.4g}, where there were no data. Name it or leave it out."
    )
    lines = [
        f'<function name="{name}">',
        f"  {comment(remark)}",
        *(f"  {line}" for line in table),
        "</function>",
    ]
    edit = add_deltas(
        add_functions(edit, lines),
        {term.coefficient: [name]},
        PREFIX,
        coefficient_reference(aircraft, section),
        "unnamed: no physics",
    )
    for path, content in edit.files().items():
        path.write_bytes(content)
