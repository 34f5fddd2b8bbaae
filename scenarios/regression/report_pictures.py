"""Puts a run's contact sheet into the report, where there is one."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Final

SHEET_FILE: Final = "contact_sheet.png"
WIDTH: Final = 1400  # [px]
QUALITY: Final = 80  # of JPEG


def picture(run: Path) -> str:
    """Return the contact sheet of a run as HTML; empty where there is none."""
    path = run / SHEET_FILE
    if not path.is_file():
        return ""
    from PIL import Image  # noqa: PLC0415 - seldom needed

    with Image.open(path) as image:
        height = round(image.height * WIDTH / image.width)
        small = image.convert("RGB").resize((WIDTH, height), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=QUALITY, optimize=True)
    content = base64.b64encode(buffer.getvalue()).decode("ascii")
    return (
        f"<h3>Pictures</h3><img class=sheet loading=lazy width={WIDTH} height={height} "
        f'alt="Contact sheet of the run" src="data:image/jpeg;base64,{content}">'
    )


__all__ = ["picture"]
