"""Files that are there as a whole or not at all, lines that survive a killed process, and locks that end with it."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from rig.errors import ArchiveError, BadInput

SYNC_EVERY = 0.5  # s; with the disk's own latency a line is safe within a second

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)
_VANISHED = (errno.ENOENT, errno.ENOTDIR, errno.EEXIST, errno.ESTALE)


@contextlib.contextmanager
def keeping(path: Path) -> Iterator[None]:
    """Failures of the file system as ArchiveError: where, what was found, what was wanted."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if error.errno in _FULL:
            raise ArchiveError(f"{path}: found a full disk ({reason}), wanted room for the record") from error
        if error.errno in _FORBIDDEN:
            raise ArchiveError(
                f"{path}: found a folder that cannot be written ({reason}), wanted permission"
            ) from error
        if error.errno in _VANISHED:
            raise ArchiveError(f"{path}: found no such folder ({reason}), wanted a folder to write into") from error
        raise ArchiveError(f"{path}: found a failing file system ({reason}), wanted to write") from error


def sync_folder(path: Path) -> None:
    """Put the folder's list of names on the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def take_lock(path: Path) -> int:
    """Descriptor of a lock file, held until it is closed; raises BadInput if another process holds it."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    for _ in range(20):  # somebody who asks for the status holds it for an instant
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return descriptor
        except BlockingIOError:
            time.sleep(0.005)
    os.close(descriptor)
    raise BadInput(f"{path}: found it held by another process, wanted to be the only one who writes")


@contextlib.contextmanager
def waited_for(path: Path) -> Iterator[None]:
    """A lock that is held for an instant only, so that it is waited for."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def lock_is_held(path: Path) -> bool:
    """Whether a live process holds the lock file."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


class NewFile:
    """A file that appears under its name only when it is whole and on the disk."""

    def __init__(self, path: Path) -> None:
        self.path, self.size = path, 0
        self._part = path.with_name(f".{path.name}.part")
        self._hash = hashlib.sha256()
        with keeping(path):
            self._descriptor = os.open(self._part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)

    @property
    def sha256(self) -> str:
        return self._hash.hexdigest()

    def write(self, data: bytes | memoryview) -> None:
        """Append; on failure the unfinished file is removed, so that there is room for the seal."""
        rest = memoryview(data)
        try:
            with keeping(self.path):
                while rest:
                    rest = rest[os.write(self._descriptor, rest) :]
        except ArchiveError:
            self.discard()
            raise
        self._hash.update(data)
        self.size += len(data)

    def close(self) -> None:
        """Sync, rename, sync the folder."""
        try:
            with keeping(self.path):
                os.fsync(self._descriptor)
                os.rename(self._part, self.path)
                sync_folder(self.path.parent)
        except ArchiveError:
            self.discard()
            raise
        os.close(self._descriptor)

    def discard(self) -> None:
        """Give up an unfinished file."""
        os.close(self._descriptor)
        with contextlib.suppress(OSError):
            self._part.unlink()


def write_whole(path: Path, data: bytes) -> None:
    """Write a small file so that it is there as a whole or not at all."""
    file = NewFile(path)
    file.write(data)
    file.close()


class AppendOnly:
    """A file that only grows: each addition is one write, and a timer thread puts it on the disk."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with keeping(path):
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        self._dirty, self._stop = False, threading.Event()
        self._failure: OSError | None = None
        self._thread = threading.Thread(target=self._sync_now_and_then, name=f"sync {path.parent.name}", daemon=True)
        self._thread.start()

    def size(self) -> int:
        """Bytes in the file now. Raises ArchiveError if it was deleted."""
        with keeping(self._path):
            status = os.fstat(self._descriptor)
            if status.st_nlink == 0:
                raise OSError(errno.ENOENT, "it was deleted while it was being written")
        return status.st_size

    def append(self, data: bytes, at: int) -> None:
        """Add bytes in one write behind byte `at`; what was written before is never lost. Raises ArchiveError."""
        size = self.size()
        with keeping(self._path):
            if self._failure is not None:
                raise self._failure
            if size != at:
                raise OSError(errno.EIO, f"it was changed by somebody else, from {at} to {size} bytes")
            written = os.write(self._descriptor, data)
            if written < len(data):
                os.ftruncate(self._descriptor, at)  # only our own half
                raise OSError(errno.ENOSPC, f"{written} of {len(data)} bytes written")
        self._dirty = True

    def sync(self) -> None:
        """Put everything on the disk now. Raises ArchiveError."""
        with keeping(self._path):
            os.fsync(self._descriptor)

    def close(self) -> None:
        """Stop the timer and let go of the file."""
        self._stop.set()
        self._thread.join()
        with contextlib.suppress(OSError):  # a full or vanished disk has been reported by what was written last
            os.fsync(self._descriptor)
        os.close(self._descriptor)

    def _sync_now_and_then(self) -> None:
        while not self._stop.wait(SYNC_EVERY):
            if not self._dirty:
                continue
            self._dirty = False
            try:
                os.fdatasync(self._descriptor)
            except OSError as error:  # raised to the next one who writes
                self._failure = error
                return
