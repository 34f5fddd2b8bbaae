"""The contact sheet of a run, reduced for the report."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any, Final

SHEET_FILE: Final = "contact_sheet.png"
WIDTH: Final = 1400  # [px]
QUALITY: Final = 80  # of JPEG


def picture(run: Path) -> dict[str, Any] | None:
    """Return the contact sheet of a run as a JPEG: width and height [px], content in base64.

    Returns:
        None if there is no contact sheet.
    """
    path = run / SHEET_FILE
    if not path.is_file():
        return None
    from PIL import Image  # noqa: PLC0415 - seldom needed

    with Image.open(path) as image:
        height = round(image.height * WIDTH / image.width)
        small = image.convert("RGB").resize((WIDTH, height), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=QUALITY, optimize=True)
    content = base64.b64encode(buffer.getvalue()).decode("ascii")
    return {"width": WIDTH, "height": height, "content": content}


__all__ = ["picture"]
