"""A word of shared memory by which the kernel says at once that a thread has died with it in its hands.

A pipe that closes says so too, but last: a process that was killed first gives back its memory, and where others keep
the machine busy that takes tenths of a second. A robust mutex (POSIX) is marked, and who waits for it woken, before.
What other threads had begun to send may still go out after that, so who is woken has to look once more when the pipe
has closed.
"""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
from typing import Self

_SIZE = 4096  # bytes: a page, of which the mutex takes less than a hundred
_SHARED, _ROBUST = 1, 1  # PTHREAD_PROCESS_SHARED, PTHREAD_MUTEX_ROBUST of Linux
_NEEDED = ("pthread_mutexattr_setrobust", "pthread_mutexattr_setpshared", "pthread_mutex_lock", "pthread_mutex_unlock")


class Lifeline:
    """One mutex; `descriptor` is that of its memory, for the process that waits."""

    def __init__(self, descriptor: int) -> None:
        """Raises OSError if it is not the descriptor of such memory.

        The page is never given back: a thread that holds the mutex has its address in a list that the kernel reads.
        """
        self.descriptor, self._libc = descriptor, ctypes.CDLL(None, use_errno=True)
        self._libc.mmap.restype = ctypes.c_void_p
        place = self._libc.mmap(
            None,
            ctypes.c_size_t(_SIZE),
            mmap.PROT_READ | mmap.PROT_WRITE,
            mmap.MAP_SHARED,
            descriptor,
            ctypes.c_long(0),
        )
        if place == ctypes.c_void_p(-1).value:
            raise OSError(ctypes.get_errno(), "lifeline: found no memory behind its descriptor, wanted a page")
        self._mutex = ctypes.c_void_p(place)

    @classmethod
    def new(cls) -> Self | None:
        """One that nobody holds; None where the system has no such thing."""
        if not hasattr(os, "memfd_create") or not all(hasattr(ctypes.CDLL(None), name) for name in _NEEDED):
            return None
        descriptor = os.memfd_create("lifeline")
        os.ftruncate(descriptor, _SIZE)
        made = cls(descriptor)
        kind = ctypes.byref((ctypes.c_char * _SIZE)())
        calls = (
            made._libc.pthread_mutexattr_init(kind),
            made._libc.pthread_mutexattr_setpshared(kind, _SHARED),
            made._libc.pthread_mutexattr_setrobust(kind, _ROBUST),
            made._libc.pthread_mutex_init(made._mutex, kind),
        )
        return None if any(calls) else made

    def hold(self) -> None:
        """By this thread, for as long as it lives or until it lets go."""
        self._libc.pthread_mutex_lock(self._mutex)

    def let_go(self) -> None:
        """By the thread that holds it; any other changes nothing."""
        self._libc.pthread_mutex_unlock(self._mutex)

    def broken(self) -> bool:
        """Wait until nobody holds it; whether who did has died."""
        found = self._libc.pthread_mutex_lock(self._mutex)
        if found in (0, errno.EOWNERDEAD):
            self.let_go()
        return bool(found in (errno.EOWNERDEAD, errno.ENOTRECOVERABLE))

    def close(self) -> None:
        """Its memory stays as long as somebody waits."""
        os.close(self.descriptor)
