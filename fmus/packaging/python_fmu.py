"""FMUs that run a slave class in Python."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module

from ..interface.tables import ALL_INTERFACES
from .bundle import Bundle
from .compile import SOURCES
from .native import NativeFmu
from .python_runtime import python_options

HOST = "python_host.py"  # what the library calls Python through


def bundle_fmu(bundle: Bundle, resources: Mapping[str, bytes] | None = None) -> NativeFmu:
    """Describe the FMU that runs a bundle of the project's code.

    Args:
        bundle: The code.
        resources: Contents of further resources, by name.
    """
    interface = next(i for i in ALL_INTERFACES if i.model == bundle.model)
    module, name = bundle.law
    law = getattr(import_module(f"panda_cosim.{module}"), name).__doc__ or ""
    files = {HOST: host(), **bundle.resources(), **(resources or {})}
    options = (("package", bundle.package), ("slave", " ".join(bundle.slave)))
    return NativeFmu(interface, "python", law, files, (*options, *python_options(bundle.needs)))


def python_key() -> str:
    """Return the options and files that every Python FMU needs."""
    return repr((python_options(("numpy", "mujoco")), host()))


def host() -> bytes:
    """The file that the library runs first."""
    return (SOURCES / HOST).read_bytes()
