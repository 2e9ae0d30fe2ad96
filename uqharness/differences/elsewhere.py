"""A flight in another environment: its own Python interpreter, with its own version of JSBSim.

``python -m uqharness.differences.elsewhere JOB.json OUT.npz`` is the child; `fly_elsewhere` starts it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from sysid.arrays import FloatArray
from uqharness.child_process import ending, give_answer, run_module
from uqharness.differences.channels import Channel
from uqharness.differences.flown import How, flown
from uqharness.errors import BadInputError
from uqharness.files import write_json
from uqharness.scratch import scratch_folder
from uqharness.simulator import Aircraft, Source, engine, find_aircraft

LONGEST_S = 600.0


class RefusedError(BadInputError):
    """The other JSBSim runs, and does not fly the aircraft."""


def fly_elsewhere(
    python: Path, aircraft: Aircraft, script: Path, channels: Sequence[Channel], how: How
) -> tuple[dict[str, FloatArray], str]:
    """Channels of a flight by name, ``time_s`` among them, flown by another interpreter, and the version of its JSBSim.

    Parameters
    ----------
    python
        Interpreter of an environment that has JSBSim and what this package needs.

    Raises
    ------
    RefusedError
        Where its JSBSim does not fly the aircraft.
    BadInputError
        Where the interpreter cannot be started, or its environment lacks a library.
    """
    with scratch_folder("elsewhere") as scratch:
        job, out = scratch.path / "job.json", scratch.path / "out.npz"
        places = {
            "aircraft": aircraft.folder,
            "engine": aircraft.engine_path,
            "systems": aircraft.systems_path,
            "script": script,
        }
        # A stock aircraft's engines are those of its own JSBSim: both sides fly the same files.
        document = {k: str(v) for k, v in places.items()} | {
            "channels": [asdict(c) for c in channels],
            "how": asdict(how),
        }
        write_json(job, document)
        ended = run_module(__name__, job, out, timeout_s=LONGEST_S, python=python)
        if ended.answer.get("error"):
            raise RefusedError(f"{python}: {ended.answer['error']}")
        if not out.is_file():
            said = ended.errors or ended.said or "nothing was said"
            end = "took too long" if ended.code is None else f"ended with {ending(ended.code)}"
            raise BadInputError(
                f"{python}: the flight {end}: {said}; an environment is needed that has JSBSim 1.3 and what uqharness needs "
                "(pip install uqharness, then pip install jsbsim==VERSION)"
            )
        with np.load(out) as found:
            signals = dict(zip(found["names"].tolist(), found["columns"], strict=True))
            return signals, str(ended.answer.get("jsbsim", ""))


def _child(job: Path, out: Path) -> None:
    asked = json.loads(job.read_text(encoding="utf-8"))
    channels = [Channel(**{**row, "source": Source(**row["source"])}) for row in asked["channels"]]
    try:
        aircraft = replace(
            find_aircraft(asked["aircraft"]),
            engine_path=Path(asked["engine"]),
            systems_path=Path(asked["systems"]),
        )
        signals = flown(aircraft, Path(asked["script"]), channels, How(**asked["how"]))
    except BadInputError as error:
        give_answer({"error": str(error)})
        return
    np.savez(out, names=np.array(list(signals)), columns=np.array(list(signals.values())))
    give_answer({"jsbsim": engine.JSBSIM_VERSION})


if __name__ == "__main__":
    _child(Path(sys.argv[1]), Path(sys.argv[2]))
