"""Arrays of a .npz that may come from anybody: nothing is unpickled, and no more memory is taken than the file is said to need."""

from __future__ import annotations

import io
import lzma
import math
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import in_a_line
from sysid.foreign.regular_files import in_words, read_regular
from uqharness.errors import BadInputError

MOST_FILE_BYTES = 500_000_000
MOST_BYTES = 1_000_000_000
"""Of all arrays together, unpacked: a study of 12 parameters, 8192 samples and 100 draws has 200 MB an output."""
_KINDS = "fiub"
_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    tokenize.TokenError,
    OSError,
    EOFError,
    RuntimeError,
    NotImplementedError,
    ValueError,
    SyntaxError,
    TypeError,
    OverflowError,
    LookupError,
    MemoryError,
)
"""What zipfile and numpy raise of a damaged file, an encrypted or an unknown one."""


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of numbers by name. Raises BadInputError for anything else, and for more than MOST_BYTES of them."""
    try:
        content = read_regular(path, MOST_FILE_BYTES)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            size = sum(member.file_size for member in members)
            if size > MOST_BYTES:
                raise ValueError(
                    f"its arrays would take {in_words(size)}, at most {in_words(MOST_BYTES)} are read"
                )
            return {
                member.filename.removesuffix(".npy"): _array(archive.read(member))
                for member in members
            }
    except _DAMAGED as error:
        words = in_a_line(error)
        raise BadInputError(
            f"{path}: not a study written by uqharness, nor any other archive of arrays: {words}; write it again"
        ) from None


def _array(content: bytes) -> NDArray[Any]:
    """One array. ValueError for one that holds other things than numbers, and for a header that promises what does not follow."""
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[version]
    shape, fortran, dtype = read(file)
    if dtype.kind not in _KINDS or dtype.hasobject:
        raise ValueError(f"an array of type {dtype} among its arrays")
    if math.prod(shape) * dtype.itemsize != len(content) - file.tell():
        raise ValueError("an array is cut short, or its header does not tell its size")
    flat = np.frombuffer(content, dtype, offset=file.tell())
    return flat.reshape(shape, order="F" if fortran else "C").copy()
