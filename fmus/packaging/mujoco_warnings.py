"""MuJoCo's warnings, which would otherwise go to a file in the working directory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock
from typing import Final

import mujoco

_one_taker: Final = RLock()  # MuJoCo has one handler per process


@contextmanager
def taken_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings; the handler before is put back. Other threads wait.

    MuJoCo's own handler writes MUJOCO_LOG.TXT.

    Yields:
        The warnings so far.
    """
    texts: list[str] = []
    with _one_taker:
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(texts.append)
        try:
            yield texts
        finally:
            mujoco.set_mju_user_warning(before)


__all__ = ["taken_warnings"]
