"""Who flies a program in a test: numpy for some frames, compiled code for many.

Their bits are the same (test_flight.py).
"""

from __future__ import annotations

from uqharness.batch.interpret import Interpreter
from uqharness.batch.llvm import choose_target
from uqharness.batch.llvm_flight import compile_program
from uqharness.batch.program import Flyer, Program

MANY = 100
"""From so many frames on it takes less time to compile a whole aircraft than to fly it by numpy."""


def flyer_of(program: Program, frames: int) -> Flyer:
    """What flies ``frames`` frames of the program soonest."""
    return compile_program(program, choose_target()) if frames >= MANY else Interpreter(program)
