"""MuJoCo's warnings, for which a process has one handler."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock

import mujoco

_one_taker = RLock()


@contextmanager
def taken_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings, which its own handler writes to a file; other threads wait."""
    texts: list[str] = []
    with _one_taker:
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(texts.append)
        try:
            yield texts
        finally:
            mujoco.set_mju_user_warning(before)
