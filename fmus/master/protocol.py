"""The protocol between `remote_slave` and `remote_host`: raw doubles in each tick, else JSON.

A request is `REQUEST` (kind, mask of the blocks that are put, length of the JSON text, time, step
size), the values of all put blocks, and the text. A reply is `REPLY` (failed, length of the JSON
text), the values of all get blocks, and the text. Nothing is pickled.
"""

from __future__ import annotations

import json
import struct
from typing import Any, Final

REQUEST: Final = struct.Struct("<cIIdd")
REPLY: Final = struct.Struct("<?I")
CALL, STEP, GET = b"C", b"S", b"G"
MAX_BLOCKS: Final = 32  # of values to put, one bit each


def pack(content: Any) -> bytes:
    """Return JSON; `unpack` restores floats bit for bit, infinity and NaN included."""
    return json.dumps(content).encode() if content else b""


def unpack(text: bytes | bytearray) -> Any:
    """Return what was packed."""
    return json.loads(text) if text else {}
