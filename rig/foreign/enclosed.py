"""Binary files of others (NPY, NPZ, MAT version 5, HDF5), read in a process of their own.

Readers of such files are partly C: a damaged file can end the process that reads it by a signal, keep it busy for ever
or have it ask for all memory. Here that is one process more, which takes the file on its standard input, may use as
much processor time and memory as a sound file of that length needs, and gives its arrays in a ZIP file, or a reason.
"""

from __future__ import annotations

import io
import json
import resource
import struct
import subprocess
import sys
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

HEADER = 128  # bytes of a MAT file: text, version and byte order
WITHIN = 300.0  # s, however slow the machine is
SECONDS, MEMORY = 20.0, 400_000_000  # of processor time and bytes, for any file
SECONDS_EACH, MEMORY_EACH = 2e-6, 30  # and for every byte of it; some are compressed
REFUSED = 2
NAMES = "names.json"  # of the ZIP file, in the order of the arrays
V7_3 = "found MAT version 7.3, which is HDF5, wanted `reading: {format: hdf5}`, with columns such as `gyro[2,:]`"
Found = Iterator[tuple[str, NDArray[Any]]]
FAULTS = (
    ArithmeticError, AttributeError, EOFError, LookupError, MemoryError, NameError, NotImplementedError, OSError,
    RuntimeError, SyntaxError, TypeError, ValueError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What readers raise for damaged files."""


def arrays(raw: bytes, form: str) -> Found:
    """Every array of numbers by name, `structure.field` of structures; BadInput for another file or a damaged one."""
    if form == "mat":
        _refuse_others(raw)
    command = [sys.executable, "-P", "-m", __name__, form]
    try:
        done = subprocess.run(command, input=raw, capture_output=True, timeout=WITHIN, check=False)
    except subprocess.TimeoutExpired:
        raise BadInput(f"found no end of {TITLES[form]} within {WITHIN:g} s, wanted a sound one") from None
    yield from given(form, done.returncode, done.stdout, done.stderr)


def given(form: str, code: int, out: bytes, said: bytes) -> Found:
    """What the process has given. Raises BadInput if it refused the file or ended in any other way."""
    reasons = said.decode("utf-8", "replace").strip().splitlines()
    if code == REFUSED and reasons:
        raise BadInput(reasons[-1])
    if code:
        raise BadInput(f"found a damaged file (its reader stopped), wanted {TITLES[form]}")
    with zipfile.ZipFile(io.BytesIO(out)) as found:
        for number, name in enumerate(json.loads(found.read(NAMES))):
            yield name, np.load(io.BytesIO(found.read(f"{number}.npy")), allow_pickle=False)


def _refuse_others(raw: bytes) -> None:
    """By its first bytes: version and byte order of a version 5, a zero among the first four of a version 4."""
    major = max(raw[124:126], default=0)
    if len(raw) >= HEADER and raw[126:128] in (b"IM", b"MI") and major == 2:
        raise BadInput(V7_3)
    if not (len(raw) >= HEADER and raw[126:128] in (b"IM", b"MI")) and 0 not in raw[:4]:
        raise BadInput("found no MAT file of version 5 (its first bytes are others)")


# in the process


def answer(form: str, raw: bytes, out: IO[bytes], said: IO[str]) -> int:
    """Exit code of the process: 0 with the arrays written to `out`, 2 with the reason said."""
    warnings.simplefilter("ignore")
    try:
        found = dict(READERS[form](raw))
    except BadInput as error:
        print(error, file=said)
        return REFUSED
    except FAULTS as error:
        why = " ".join(str(error).split()) or type(error).__name__
        print(f"found no {TITLES[form].removeprefix('a ').removeprefix('an ')} ({why})", file=said)
        return REFUSED
    with zipfile.ZipFile(out, "w") as file:
        file.writestr(NAMES, json.dumps(list(found)))
        for number, array in enumerate(found.values()):
            with file.open(f"{number}.npy", "w", force_zip64=True) as place:
                np.lib.format.write_array(place, array, allow_pickle=False)
    return 0


def _npy(raw: bytes) -> Found:
    yield from _fields("array", np.load(io.BytesIO(raw), allow_pickle=False))


def _npz(raw: bytes) -> Found:
    with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
        for name in archive.files:
            yield from _fields(name, archive[name])


def _fields(name: str, array: NDArray[Any]) -> Found:
    """A structured array as its fields, any other as it is; what is no number is left out."""
    parts = [(name, array)] if array.dtype.names is None else [(f"{name}.{n}", array[n]) for n in array.dtype.names]
    return (one for one in parts if one[1].dtype.kind in "biuf")


def _mat(raw: bytes) -> Found:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        found = loadmat(cast(Any, io.BytesIO(raw)), simplify_cells=True)  # its stubs know paths only
    except NotImplementedError:
        raise BadInput(V7_3) from None
    except MatReadError as error:
        raise BadInput(f"found no {TITLES['mat'].removeprefix('a ')} ({error})") from None
    yield from _nested("", {name: value for name, value in found.items() if not name.startswith("__")})


def _nested(name: str, value: Any) -> Found:
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _nested(f"{name}.{key}" if name else str(key), part)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        yield name, value


def _hdf5(raw: bytes) -> Found:
    import h5py

    found: dict[str, NDArray[Any]] = {}

    def keep(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.shape:
            found.update(_fields(name, np.asarray(item[()])))

    with h5py.File(io.BytesIO(raw), "r") as file:
        file.visititems(keep)
    yield from found.items()


READERS: Mapping[str, Callable[[bytes], Found]] = {"npy": _npy, "npz": _npz, "mat": _mat, "hdf5": _hdf5}
TITLES = {
    "npy": "an NPY file of plain numbers", "npz": "an NPZ file of plain numbers",
    "mat": "a sound MAT file of version 5", "hdf5": "an HDF5 file that can be read",
}  # fmt: skip


def load(form: str) -> None:
    """Load what reads such files, which no limit is to count."""
    if form == "mat":
        import scipy.io  # noqa: F401
    if form == "hdf5":
        import h5py  # noqa: F401


def confine(size: int) -> None:
    """From now on no more processor time and memory than a file of so many bytes may need."""
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    spent = resource.getrusage(resource.RUSAGE_SELF)
    seconds = spent.ru_utime + spent.ru_stime + SECONDS + SECONDS_EACH * size
    for what, most in ((resource.RLIMIT_AS, used + MEMORY + MEMORY_EACH * size), (resource.RLIMIT_CPU, seconds)):
        soft = int(most)
        _, hard = resource.getrlimit(what)
        resource.setrlimit(what, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


def main() -> int:
    """The process; its only argument is the format."""
    (form,) = sys.argv[1:]
    raw = sys.stdin.buffer.read()
    load(form)
    confine(len(raw))
    return answer(form, raw, sys.stdout.buffer, sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
