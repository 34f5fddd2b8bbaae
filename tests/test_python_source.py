"""Python source that is read without being run."""

from __future__ import annotations

import parse_jobs
from fmu_support import in_process
from panda_cosim.fmus.sources import python_fmu


def test_threads_may_parse_at_one_moment() -> None:
    assert in_process(parse_jobs.in_threads, python_fmu.__file__, 300, timeout=120) == 300
