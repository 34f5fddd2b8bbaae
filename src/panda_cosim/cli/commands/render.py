"""`panda-cosim render`, `plot`, `view` and `export`."""

from __future__ import annotations

import re
from pathlib import Path

from ...fmus.atomic import check_replaceable
from ...fmus.errors import InputError
from ...result.judging.summary import Summary
from ...result.pictures.motion import position_columns
from ...result.pictures.plot import draw, save
from ...result.pictures.sheet import contact_sheet
from ...result.pictures.video import check_video
from ...result.recording import Recording
from ...result.recording.logs import MCAP, is_log, open_log
from ...result.view.mcap import write_mcap
from ...result.view.page import VIEW_FILE, shown_run, write_view
from ...result.view.run import Shown
from ...run.finished import FIGURE_FILE, PLOT_FILE, SHEET_FILE, VIDEO_FILE
from ...study.compare.reference import REFERENCE_FILE
from ...study.compare.views import reference_of, shown_reference
from ..common import MAP, OPEN_PAGE, OVERWRITE, RUN
from ..console import show, show_file, tell
from ..forms import argument, option
from ..outcome import PLOTTING, TILING, draw_video


def command(  # noqa: PLR0913 - one for each option
    run: Path = RUN,
    out: Path | None = option("--out -o DIR"),
    camera: str = option("--camera NAME", "overview"),
    size: str = option("--size WxH", "640x480"),
    fps: float = option("--fps HZ", 30.0),
    video: bool = option("--video/--no-video", True),
    overwrite: bool = OVERWRITE,
) -> None:
    """Redraw a run's video and contact sheet.

    The files video.mp4 and contact_sheet.png are drawn from the recording, without a simulation.

    ```
    panda-cosim render runs/first --size 1280x720 --camera closeup
    ```

    Args:
        out: Folder for the pictures. Default: the folder of the run.
        camera: Camera: overview, closeup, front, or another of the model.
        size: Size of the video [px]; even numbers.
        fps: Frames per second.
        video: Draw the video as well.
    """
    recording = Recording.open(run, in_order=True)
    folder = out if out is not None else recording.path.parent
    if folder.suffix.lower() in (".mp4", ".png") and not folder.is_dir():
        raise InputError(f"--out {folder}: must be a folder; the files in it have fixed names")
    files = (VIDEO_FILE, SHEET_FILE) if video else (SHEET_FILE,)
    check_replaceable(*(folder / name for name in files), overwrite=overwrite)
    position_columns(recording)  # refuses one that lacks signals, before anything is drawn
    if not (match := re.fullmatch(r"(\d{1,5})x(\d{1,5})", size.strip(), re.A)):
        raise InputError(f"--size {size!r}: must be WIDTHxHEIGHT in pixels, such as 640x480")
    width, height = map(int, match.groups())
    check_video(folder / VIDEO_FILE, fps, width, height)
    tell(TILING)
    show(str(contact_sheet(recording, folder / SHEET_FILE, camera=camera)))
    if video:
        look = {"fps": fps, "width": width, "height": height, "camera": camera}
        show(str(draw_video(recording, folder, **look)))


def plot(
    runs: list[Path] = argument("RUN [RUN]..."),
    signals: str = option("--signals LIST", ""),
    width: str | None = option("--width 88mm"),
    out: Path | None = option("--out -o FILE|DIR"),
    overwrite: bool = OVERWRITE,
) -> None:
    """Plot a run's signals on one page, or chosen ones of some runs.

    The page is plot.png. A figure of chosen signals overlays the runs, with their units; fonts are
    embedded. Both are drawn from the recording.

    ```
    panda-cosim plot runs/first
    panda-cosim plot runs/a runs/b --signals 'plant.hand_xpos[3], tracking' --out fig.pdf
    ```

    Args:
        runs: Folders of runs, or their recordings.
        signals: Signals to draw, separated by commas, in the words of criteria: plant.hand_xpos[3],
            a - b, |a - b|, or tracking, the distance between hand and command. Each has a panel.
        width: Of a figure of signals, in mm. Default: 88mm.
        out: File (.png, .pdf or .svg), or folder of plot.png; of signals, of figure.png. Default:
            the folder of the first run.
    """
    recordings = [Recording.open(run, in_order=True) for run in runs]
    path = out if out is not None else recordings[0].path.parent
    if path.is_dir() or not path.suffix:
        path /= FIGURE_FILE if signals else PLOT_FILE
    check_replaceable(path, overwrite=overwrite)
    tell(PLOTTING)
    save(draw(recordings, Summary.of(recordings[0]), signals, width), path)
    show(str(path))


def view(  # noqa: PLR0913 - one for each option
    run: Path = RUN,
    against: str | None = option("--against RUN"),
    names: Path | None = MAP,
    out: Path | None = option("--out -o FILE.html"),
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

    Args:
        against: Show another run as a ghost: a run's folder, a scenario's folder, a
            reference.parquet, or the word reference for that of the run's own scenario; or the
            curves of a log: .csv, .parquet or .mcap.
        out: Page to write. Default: in the run's folder.
    """
    path = out if out is not None else (run if run.is_dir() else run.parent) / VIEW_FILE
    check_replaceable(path, overwrite=overwrite)
    first = shown_run(run)
    write_view([first] if against is None else [first, _other(first, against, names)], path)
    show_file(path, open_page=open_page)


def _other(first: Shown, against: str, names: Path | None) -> Shown:
    """Return the run given by `--against`."""
    if against == "reference":
        return shown_reference(reference_of(first.source))
    path = Path(against)
    if is_log(path):
        return Shown(path.name, open_log(path, names, first.source), None)
    reference = path if path.name == REFERENCE_FILE else path / REFERENCE_FILE
    if reference.is_file():
        return shown_reference(reference)
    name = path.resolve().name
    return shown_run(path, name=against if name == first.name else name)


def export(
    run: Path = RUN,
    file: Path = argument("FILE"),
    rate: float = option("--rate HZ", 100.0, min=1e-3, max=1e6),
    overwrite: bool = OVERWRITE,
) -> None:
    """Write a recording as CSV, for MATLAB, or as MCAP for Foxglove and rerun.

    CSV: one column per signal and one row per tick, in full precision (RFC 4180).

    MAT: one variable per signal, such as plant_qpos with a row per tick, for MATLAB and Octave.

    MCAP: joint states, the poses of all bodies, their shapes, the signals of each FMU, events and
    the verdict, as Foxglove's messages. It needs the extra `logs`.

    ```
    panda-cosim export runs/first first.csv
    panda-cosim export runs/first first.mat
    panda-cosim export runs/first first.mcap --rate 250
    ```

    Args:
        file: The file to write: .csv, .mat or .mcap.
        rate: Of .mcap: messages a second.
    """
    recording = Recording.open(run, in_order=True)
    if file.suffix == MCAP:
        number = write_mcap(recording, file, rate, overwrite=overwrite)
        show(f"{file}: {number} instants")
        return
    write = recording.to_mat if file.suffix.lower() == ".mat" else recording.to_csv
    write(file, overwrite=overwrite)
    show(f"{file}: {recording.rows} rows, {len(recording.columns)} columns")
