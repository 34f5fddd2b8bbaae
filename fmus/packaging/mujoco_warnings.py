"""MuJoCo's warnings, which would otherwise go to a file in the working directory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco


@contextmanager
def taken_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings; the handler before is put back.

    MuJoCo has one handler per process. Its own writes MUJOCO_LOG.TXT.

    Yields:
        The warnings so far.
    """
    texts: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(texts.append)
    try:
        yield texts
    finally:
        mujoco.set_mju_user_warning(before)


__all__ = ["taken_warnings"]
