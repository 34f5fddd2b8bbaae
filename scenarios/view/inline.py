"""The page inside a notebook's output."""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape
from pathlib import Path

from ...fmus.atomic import replacing


@dataclass(frozen=True)
class Inline:
    """A page for notebooks: Jupyter, JupyterLab, VS Code.

    Attributes:
        page: The page as HTML.
        height: Of the frame around it [px].
    """

    page: str = field(repr=False)
    height: int

    def _repr_html_(self) -> str:
        """Return the page in a frame, isolated from the notebook's own scripts."""
        style = f"width:100%;height:{self.height:d}px;border:1px solid #8884;border-radius:8px"
        return (
            f'<iframe srcdoc="{escape(self.page)}" style="{style}" sandbox="allow-scripts" '
            'title="Run in 3D"></iframe>'
        )

    def save(self, path: str | Path) -> Path:
        """Write the page to a file.

        Raises:
            InputError: It cannot be written.
        """
        path = Path(path)
        with replacing(path) as partial:
            partial.write_text(self.page, encoding="utf-8")
        return path
