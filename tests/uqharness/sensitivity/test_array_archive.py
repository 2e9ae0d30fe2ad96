"""A study's file from anybody: read as written, or refused in a sentence; nothing unpickled, no
memory for empty promises.
"""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np
import pytest
from scipy import stats

from uqharness import sensitivity
from uqharness.errors import BadInputError
from uqharness.sensitivity import study as problem

UNIT = {"a": (0.0, 1.0), "b": (0.0, 1.0)}


@pytest.fixture
def study(tmp_path):
    """Arrays of a sound study's file by member."""
    made = sensitivity.run_study(
        lambda a, b, w: a + b * w, UNIT, {"w": stats.norm(0.0, 1.0)}, samples=16, draws=8
    )
    sensitivity.write_study(made, tmp_path / "sound.npz")
    with zipfile.ZipFile(tmp_path / "sound.npz") as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(members, path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def array(values):
    out = io.BytesIO()
    np.save(out, values, allow_pickle=True)
    return out.getvalue()


def promise(shape, descr="<f8"):
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        out, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return out.getvalue() + bytes(64)


class Runs:
    def __reduce__(self):
        return print, ("unpickled",)


def header(**changes):
    text = json.dumps({"names": ["a", "b"], "outputs": ["output"], "chance": True} | changes)
    return array(np.frombuffer(text.encode(), np.uint8))


HOSTILE = {
    "a promise": {"theta.npy": promise((10**12,))},
    "an object": {"theta.npy": array(np.array([Runs()], dtype=object))},
    "text": {"theta.npy": array(np.array(["x"]))},
    "other shape": {"lower.npy": array(np.zeros(3))},
    "other draws": {"0/corners.npy": array(np.zeros((4, 7)))},
    "other corners": {"0/corners.npy": array(np.zeros((5, 8)))},
    "whole numbers": {"upper.npy": array(np.ones(2, dtype=int))},
    "names that are none": {"header.npy": header(names=[{}, []])},
    "no outputs": {"header.npy": header(outputs=None)},
    "no JSON": {"header.npy": array(np.zeros(3, np.uint8))},
    "no array": {"theta.npy": b"\x93NUMPY\x01\x00\xff\xff{"},
    "odd header": {"theta.npy": b"\x93NUMPY\x01\x00\x08\x00{'descr'"},
}


def test_a_sound_one_is_read(study, tmp_path):
    found = sensitivity.read_study(packed(study, tmp_path / "study.npz"))
    assert found.names == ("a", "b")
    assert found.outputs["output"].corners.shape == (4, 8)


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_one_is_refused(name, study, tmp_path, capsys):
    path = packed(study | HOSTILE[name], tmp_path / "study.npz")
    with pytest.raises(BadInputError, match=r"study\.npz: not a study") as refused:
        sensitivity.read_study(path)
    assert "\n" not in str(refused.value)
    assert "unpickled" not in capsys.readouterr().out


def test_a_missing_array(study, tmp_path):
    del study["theta.npy"]
    with pytest.raises(BadInputError, match="it lacks 'theta'"):
        sensitivity.read_study(packed(study, tmp_path / "study.npz"))


def test_a_damaged_archive_is_refused_or_gives_the_same_arrays(study, tmp_path):
    content = packed(study, tmp_path / "study.npz").read_bytes()
    sound = problem.read_arrays(tmp_path / "study.npz")
    refused = 0
    for place in range(40, len(content), 31):
        damaged = bytearray(content)
        damaged[place] ^= 0x41
        (tmp_path / "damaged.npz").write_bytes(damaged)
        try:
            found = problem.read_arrays(tmp_path / "damaged.npz")
        except BadInputError:
            refused += 1
            continue
        # A name may be the damaged part; what an array holds may not.
        assert sorted(v.tobytes() for v in found.values()) == sorted(
            v.tobytes() for v in sound.values()
        )
    assert refused > 50


def test_a_bomb_is_refused_before_it_is_unpacked(study, tmp_path, monkeypatch):
    path = packed(study, tmp_path / "study.npz")
    monkeypatch.setattr(problem, "MAX_BYTES", 100)
    with pytest.raises(BadInputError, match="would take"):
        sensitivity.read_study(path)
