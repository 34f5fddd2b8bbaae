"""The bytes of an instance's state: a header that says whose it is, then numbers."""

from __future__ import annotations

import json
import struct
from typing import Any, Final

import numpy as np

from .telling import SlaveError
from .values import Array

MAGIC: Final = b"PCS2"
CODE: Final = __name__.partition(".")[0]  # in an FMU, the name of its package: of its content


def pack(model: str, header: dict[str, Any], *numbers: Array) -> bytes:
    """Return a state as bytes.

    Args:
        model: Model name.
        header: What is not numbers; JSON.
        *numbers: Arrays.
    """
    text = json.dumps({"model": model, "code": CODE} | header).encode()
    body = b"".join(part.tobytes() for part in numbers)
    return MAGIC + struct.pack("<I", len(text)) + text + body


def unpack(model: str, state: bytes) -> tuple[dict[str, Any], Array]:
    """Take a state apart.

    Args:
        model: Model name.
        state: What `pack` returned.

    Returns:
        The header, and all numbers in one array.

    Raises:
        SlaveError: The state is damaged, or one of other code.
    """
    if state[:4] != MAGIC:
        raise SlaveError("the state is not one of this FMU")
    try:
        (length,) = struct.unpack_from("<I", state, 4)
        header: dict[str, Any] = json.loads(state[8 : 8 + length])
        numbers = np.frombuffer(state, offset=8 + length)
        whose = (header["model"], header["code"])
    except (ValueError, LookupError, TypeError, struct.error) as error:
        raise SlaveError("the state is damaged") from error
    if whose != (model, CODE):
        raise SlaveError(f"the state is one of {whose}, not of {(model, CODE)}")
    return header, numbers
