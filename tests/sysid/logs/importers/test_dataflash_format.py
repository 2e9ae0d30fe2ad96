"""What a FMT record says, against struct's sizes; records that contradict themselves."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from sysid.logs.dataflash import CHARACTERS, make_format, scaled, text

SIZES = {"a": 64, "n": 4, "N": 16, "Z": 64, "M": 1, "c": 2, "C": 2, "e": 4, "E": 4, "L": 4, "g": 2}


@pytest.mark.parametrize("character", sorted(CHARACTERS))
def test_sizes_are_those_of_c(character: str) -> None:
    size = SIZES.get(character) or struct.calcsize(f"<{character}")
    made = make_format(130, 3 + size, "ABC", character, "X")
    assert made is not None
    assert made.dtype.itemsize == size
    assert make_format(130, 4 + size, "ABC", character, "X") is None


def test_a_payload_is_read_as_struct_wrote_it() -> None:
    made = make_format(130, 3 + 8 + 1 + 4 + 2 + 4, "GPS", "QBLCe", "TimeUS,I,Lat,Spd,Alt")
    assert made is not None
    row = np.frombuffer(struct.pack("<QBiHi", 5_000_000, 1, -370000000, 2345, 12345), made.dtype)
    values = {c: scaled(row[c], k)[0] for c, k in zip(made.columns, made.characters, strict=True)}
    assert values == {
        "TimeUS": 5_000_000,
        "I": 1,
        "Lat": pytest.approx(-37.0),
        "Spd": pytest.approx(23.45),
        "Alt": 123.45,
    }
    assert made.time_column == ("TimeUS", 1e-6)
    assert made.instance_column == "I"


@pytest.mark.parametrize(
    ("length", "name", "characters", "columns"),
    [
        (7, "A B", "f", "X"),
        (7, "ABCDE", "f", "X"),
        (7, "Ä", "f", "X"),
        (7, "ABC", "ff", "X"),
        (11, "ABC", "ff", "X,X"),
        (11, "ABC", "ff", "X,"),
        (7, "ABC", "?", "X"),
        (8, "ABC", "f", "X"),
        (7, "ABC", "f", ""),
    ],
)
def test_records_that_contradict_themselves_are_none(
    length: int, name: str, characters: str, columns: str
) -> None:
    assert make_format(130, length, name, characters, columns) is None
    assert make_format(130, 7, "ABC", "f", "X") is not None


def test_a_float_is_no_instance_and_milliseconds_are_a_time() -> None:
    made = make_format(130, 11, "ABC", "fI", "I,TimeMS")
    assert made is not None
    assert made.instance_column is None
    assert made.time_column == ("TimeMS", 1e-3)
    bare = make_format(130, 7, "ABC", "f", "X")
    assert bare is not None
    assert bare.time_column is None


def test_texts_end_at_their_first_zero() -> None:
    assert text(b"ab\0cd") == "ab"
    assert text(b"\xe4bc") == "äbc"
    assert scaled(np.array([b"ab\0c", b"xyz"]), "n").tolist() == ["ab", "xyz"]


def test_the_clock_of_an_old_gps_message_is_not_its_time_of_week() -> None:
    made = make_format(130, 11, "GPS", "II", "TimeMS,T")
    assert made is not None
    assert made.time_column == ("T", 1e-3)
    new = make_format(130, 15, "GPS", "QI", "TimeUS,T")
    assert new is not None
    assert new.time_column == ("TimeUS", 1e-6)
