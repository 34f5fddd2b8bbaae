"""`panda-cosim view`."""

from __future__ import annotations

from pathlib import Path

from ....fmus.atomic import check_replaceable
from ...compare.reference import REFERENCE_FILE
from ...compare.views import reference_of, shown_reference
from ...view.export import VIEW_FILE, shown_run, write_view
from ...view.run import Shown
from ..console import show_file
from ..options import MESHES, OPEN_PAGE, OVERWRITE, RUN, Meshes, option


def command(  # noqa: PLR0913 - one for each option
    run: Path = RUN,
    against: str | None = option(
        "--against RUN",
        "Show another run as a ghost: a run's folder, a scenario's folder, a "
        "reference.parquet, or the word reference for that of the run's own scenario.",
    ),
    out: Path | None = option("--out -o FILE.html", "Page to write. Default: in the run's folder."),
    meshes: Meshes = MESHES,
    open_page: bool = OPEN_PAGE,
    overwrite: bool = OVERWRITE,
) -> None:
    """Show a run in 3D in the browser: one page that needs no network.

    The page shows the recording: turn the camera, scrub, follow the hand, add any signal as a
    curve. Add #t=2.3&cam=front to its address to link to an instant and a camera.

    ```
    panda-cosim view runs/first --open
    panda-cosim view runs/second --against runs/first --out compared.html
    panda-cosim view runs/first --against reference
    ```
    """
    path = out if out is not None else (run if run.is_dir() else run.parent) / VIEW_FILE
    check_replaceable(path, overwrite=overwrite)
    first = shown_run(run, meshes=meshes)
    write_view([first] if against is None else [first, _other(first, against)], path)
    show_file(path, open_page=open_page)


def _other(first: Shown, against: str) -> Shown:
    """Return the run given by `--against`."""
    if against == "reference":
        return shown_reference(reference_of(first.source))
    path = Path(against)
    reference = path if path.name == REFERENCE_FILE else path / REFERENCE_FILE
    if reference.is_file():
        return shown_reference(reference)
    name = path.resolve().name
    return shown_run(path, name=against if name == first.name else name)
