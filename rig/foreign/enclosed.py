"""MATLAB files of version 5, read in a process of their own.

scipy's reader is partly C: a damaged file can end the process that reads it by a signal. Here that is one process more,
which takes the file on its standard input and gives its arrays in a ZIP file, or a reason.
"""

from __future__ import annotations

import io
import json
import struct
import subprocess
import sys
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

HEADER = 128  # bytes: text, version and byte order
WITHIN = 300.0  # s
REFUSED = 2
NAMES = "names.json"  # of the ZIP file, in the order of the arrays
V7_3 = "found MAT version 7.3, which is HDF5, wanted `reading: {format: hdf5}`, with columns such as `gyro[2,:]`"


def arrays(raw: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    """Every array of numbers by name, `structure.field` of structures. BadInput for no MAT file or a damaged one."""
    _refuse_others(raw)
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", __name__], input=raw, capture_output=True, timeout=WITHIN, check=False
        )
    except subprocess.TimeoutExpired:
        raise BadInput(f"found no end of a MAT file within {WITHIN:g} s, wanted a sound one") from None
    if done.returncode == REFUSED:
        raise BadInput(done.stderr.decode("utf-8", "replace").strip().splitlines()[-1])
    if done.returncode:
        raise BadInput("found a damaged MAT file (its reader stopped), wanted a sound one of version 5")
    with zipfile.ZipFile(io.BytesIO(done.stdout)) as found:
        for number, name in enumerate(json.loads(found.read(NAMES))):
            yield name, np.load(io.BytesIO(found.read(f"{number}.npy")), allow_pickle=False)


def _refuse_others(raw: bytes) -> None:
    """By its first bytes: version and byte order of a version 5, a zero among the first four of a version 4."""
    major = max(raw[124:126], default=0)
    if len(raw) >= HEADER and raw[126:128] in (b"IM", b"MI") and major == 2:
        raise BadInput(V7_3)
    if not (len(raw) >= HEADER and raw[126:128] in (b"IM", b"MI")) and 0 not in raw[:4]:
        raise BadInput("found no MAT file of version 5 (its first bytes are others)")


def _within(raw: bytes) -> dict[str, NDArray[Any]]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    warnings.simplefilter("ignore")
    try:
        found = loadmat(cast(Any, io.BytesIO(raw)), simplify_cells=True)  # its stubs know paths only
    except NotImplementedError:
        raise BadInput(V7_3) from None
    except (MatReadError, ValueError, TypeError, KeyError, IndexError, OSError, EOFError, ArithmeticError,
            AttributeError, MemoryError, UnboundLocalError, struct.error, zlib.error) as error:  # fmt: skip
        raise BadInput(f"found no sound MAT file of version 5 ({' '.join(str(error).split())})") from error
    return dict(_nested("", {name: value for name, value in found.items() if not name.startswith("__")}))


def _nested(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _nested(f"{name}.{key}" if name else str(key), part)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        yield name, value


def main() -> int:
    """The process: 0 with the arrays on its standard output, 2 with the reason on its standard error."""
    try:
        found = _within(sys.stdin.buffer.read())
    except BadInput as error:
        print(error, file=sys.stderr)
        return REFUSED
    with zipfile.ZipFile(sys.stdout.buffer, "w") as file:
        file.writestr(NAMES, json.dumps(list(found)))
        for number, array in enumerate(found.values()):
            with file.open(f"{number}.npy", "w") as place:
                np.lib.format.write_array(place, array, allow_pickle=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
