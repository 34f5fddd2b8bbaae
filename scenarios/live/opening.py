"""Opens the page of a live run in the browser, without showing its address to other users.

The address holds the token, and other users of the machine see the arguments of each program. So
the browser is given a file that only this user can read, and that leads to the page.
"""

from __future__ import annotations

import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Final

FILE: Final = "open.html"
PAGE: Final = """<!DOCTYPE html>
<meta charset="utf-8">
<meta http-equiv="refresh" content="0; url={address}">
<a href="{address}">The live run</a>
"""


@contextmanager
def opened(address: str, folder: Path) -> Iterator[None]:
    """Open a page in the browser; the file that leads to it goes at the end.

    Args:
        address: Of the page, with its token.
        folder: Folder for the file.
    """
    path = folder / FILE
    path.touch(mode=0o600, exist_ok=False)
    path.write_text(PAGE.format(address=escape(address)), encoding="utf-8")
    uri = path.resolve().as_uri()
    # In a thread: some browsers stay in the foreground until they are closed.
    opening = threading.Thread(target=webbrowser.open, args=[uri], daemon=True)
    try:
        opening.start()
        yield
    finally:
        path.unlink(missing_ok=True)


__all__ = ["opened"]
