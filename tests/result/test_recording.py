"""Recordings are read back bit for bit, and survive any end of a run."""

import csv
import math
import re
import resource
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import loadmat

from bounded import ran
from panda_cosim.fmus.errors import InputError, SimulationError
from panda_cosim.result.recording import Column, MemoryRecorder, Recorder, Recording, storage
from panda_cosim.result.recording import recorder as recorder_module
from panda_cosim.task.rotations import Array
from refusals import refused

COLUMNS = (
    Column("time", "s", "instant"),
    *(Column(f"plant.qpos[{i}]", "rad", "joint position") for i in range(1, 4)),
    *(Column(f"plant.jac[{i},{j}]") for i in range(1, 3) for j in range(1, 4)),
    Column("plant.contact_force", "N", "fingers on the block"),
)
WIDTH = len(COLUMNS)
METADATA = {"scenario": "x", "parameters": {"controller": {"kp": [1.5, 2.5]}}, "name": "\u00e4"}


def make_rows(count: int, first: int = 0) -> Array:
    """Return rows whose times count up, with numbers that need all their digits."""
    rows = np.random.default_rng(first).normal(size=(count, WIDTH))
    rows[:, 0] = np.arange(first, first + count) * 0.001
    return rows


def record(folder: Path, rows: Array, **end: object) -> Path:
    """Make a recording of these rows."""
    recorder = Recorder(folder, COLUMNS, METADATA)
    recorder.append(rows)
    return recorder.close(**{"complete": True, **end})  # type: ignore[arg-type]


def interrupted(folder: Path, batches: int = 3) -> Path:
    """Make a stream as a killed process leaves it, with 10 rows a batch."""
    recorder = Recorder(folder, COLUMNS, METADATA)
    for k in range(batches):
        recorder.append(make_rows(10, 10 * k))
        recorder.flush()
    recorder._file.close()
    return folder / "recording.arrows"


def all_columns(recording: Recording) -> Array:
    return np.column_stack([recording[name] for name in recording.columns])


@settings(max_examples=15)
@given(
    st.lists(st.integers(0, 60), max_size=8), st.integers(3, 40), st.integers(2, 50), st.booleans()
)
def test_rows_come_back_bit_for_bit_however_they_were_cut(
    tmp_path_factory, monkeypatch, counts, buffer_rows, block_rows, flushing
):
    monkeypatch.setattr(recorder_module, "_BUFFER_ROWS", buffer_rows)
    monkeypatch.setattr(storage, "BLOCK_ROWS", block_rows)
    folder = tmp_path_factory.mktemp("run")
    rows = make_rows(sum(counts))
    recorder = Recorder(folder, COLUMNS, METADATA)
    start = 0
    for count in counts:
        recorder.append(rows[start : start + count])
        start += count
        assert recorder.rows == start
        if flushing:
            recorder.flush()
            assert Recording.open(folder).rows == start
    path = recorder.close(complete=True)
    assert path.name == "recording.parquet"
    assert [file.name for file in folder.iterdir()] == ["recording.parquet"]
    recording = Recording.open(folder)
    assert recording.rows == len(rows)
    assert np.array_equal(all_columns(recording), rows)
    assert np.array_equal(recording["plant.jac"], rows[:, 4:10].reshape(-1, 2, 3))


def test_a_recording_without_rows_can_be_read(tmp_path, monkeypatch):
    made = storage.make_schema
    monkeypatch.setattr(storage, "make_schema", lambda *given: time.sleep(0.2) or made(*given))
    recorder = Recorder(tmp_path / "run", COLUMNS, METADATA)
    recorder.flush()
    assert Recording.open(tmp_path / "run").rows == 0
    recorder.close(complete=False)


def test_special_numbers_survive(tmp_path):
    rows = make_rows(7)
    rows[:, 1] = [np.nan, np.inf, -np.inf, -0.0, 5e-324, 1.7976931348623157e308, 0.1]
    record(tmp_path / "run", rows)
    recording = Recording.open(tmp_path / "run")
    assert recording["plant.qpos[1]"].tobytes() == rows[:, 1].tobytes()
    recording.to_csv(tmp_path / "all.csv")
    with (tmp_path / "all.csv").open(newline="") as file:
        read = np.array([[float(cell) for cell in line] for line in list(csv.reader(file))[1:]])
    assert np.array_equal(read, rows, equal_nan=True)
    assert np.array_equal(np.signbit(read[:, 1]), np.signbit(rows[:, 1]))


def test_signals_have_their_shapes_units_and_metadata(tmp_path):
    rows = make_rows(5)
    record(tmp_path, rows)
    recording = Recording.open(tmp_path)
    assert recording.signals == ("time", "plant.qpos", "plant.jac", "plant.contact_force")
    assert recording.columns == tuple(column.name for column in COLUMNS)
    assert recording.units["plant.qpos[2]"] == "rad"
    assert recording.descriptions["plant.contact_force"] == "fingers on the block"
    assert recording.metadata == METADATA | {"format": 1, "complete": True, "reason": None}
    assert (recording.complete, recording.reason) == (True, None)
    assert np.array_equal(recording.time, rows[:, 0])
    assert recording["plant.qpos"].shape == (5, 3)
    assert recording["plant.jac"].shape == (5, 2, 3)
    assert np.array_equal(recording["plant.jac"][:, 1, 2], recording["plant.jac[2,3]"])
    assert recording["plant.contact_force"].shape == (5,)
    assert "plant.jac" in recording
    assert "plant.jac[2,3]" in recording
    assert "plant.jac[3,2]" not in recording
    assert list(recording) == list(recording.signals)
    assert "5 rows" in repr(recording)
    for name in ("plant.qpso", "plant.qpos[4]"):
        assert f"no signal '{name}'; did you mean 'plant.qpos" in refused(recording.elements, name)


ODD_NAMES = [
    (["hand[3]"], {"hand[3]": ()}),
    (["y", "y[1]"], {"y": (), "y[1]": ()}),
    (["y[1]", "y[2]", "y[1][1]"], {"y": (2,), "y[1][1]": ()}),
    (["pipe[1].T[2]"], {"pipe[1].T[2]": ()}),
    (["x[0]", "x[1]"], {"x[0]": (), "x": (1,)}),
    (["x[1]", "x[1,1]"], {"x[1]": (), "x[1,1]": ()}),
    (["x[999999]"], {"x[999999]": ()}),
    (["", " ", "\u00e4\n"], {"": (), " ": (), "\u00e4\n": ()}),
]


@pytest.mark.parametrize(("names", "shapes"), ODD_NAMES)
@pytest.mark.parametrize("in_memory", [False, True])
def test_whatever_names_a_recorder_has_its_recording_opens(tmp_path, names, shapes, in_memory):
    columns = [Column("time"), *map(Column, names)]
    rows = np.random.default_rng(1).normal(size=(3, len(columns)))
    with (MemoryRecorder if in_memory else Recorder)(tmp_path, columns, {}) as recorder:
        recorder.append(rows)
        recorder.close(complete=True)
    recording = recorder.recording() if in_memory else Recording.open(tmp_path)
    assert np.array_equal(all_columns(recording), rows)
    assert {n: recording[n].shape[1:] for n in recording.signals} == {"time": ()} | shapes


def test_the_csv_quotes_only_names_with_a_comma(tmp_path):
    record(tmp_path, make_rows(2))
    recording = Recording.open(tmp_path)
    recording.to_csv(tmp_path / "all.csv")
    lines = (tmp_path / "all.csv").read_bytes().split(b"\r\n")
    assert lines[0].startswith(b'time,plant.qpos[1],plant.qpos[2],plant.qpos[3],"plant.jac[1,1]",')
    assert lines[3:] == [b""]
    assert "already exists" in refused(recording.to_csv, tmp_path / "all.csv")
    recording.to_csv(tmp_path / "all.csv", overwrite=True)
    assert "cannot be written" in refused(recording.to_csv, tmp_path / "all.csv" / "below_a_file")


def test_a_mat_file_has_each_signal_with_its_unit_under_a_name_that_matlab_takes(tmp_path):
    long = "m." + 70 * "q"
    names = ["time", "plant.q[1]", "plant.q[2]", "m.ä b", "m.ä_b", "1.x", long + "a", long + "b"]
    units = {"plant.q[1]": "rad"}
    columns = [Column(name, units.get(name, "m"), f"about {name}") for name in names]
    recorder = MemoryRecorder(tmp_path, [*columns, Column("m.text", type="string")], {})
    rows = [[i + 0.1 * j for j in range(len(names))] + [f"t{i}"] for i in range(3)]
    recorder.append(np.array(rows, object))
    recorder.close(complete=True)
    recorder.recording().to_mat(tmp_path / "all.mat")
    read = loadmat(tmp_path / "all.mat")
    listed = [[str(cell[0]) if cell.size else "" for cell in row] for row in read.pop("signals")]
    assert [row[1] for row in listed] == [*recorder.recording()]
    assert listed[1] == ["plant_q", "plant.q", "rad, m", "about plant.q[1]"]
    for name, signal, *_ in listed[:-1]:
        assert re.fullmatch(r"[A-Za-z]\w{,62}", name, re.A)
        assert np.array_equal(read[name], recorder.recording()[signal].reshape(3, -1))
    assert [cell[0][0] for cell in read["m_text"]] == ["t0", "t1", "t2"]
    assert "already exists" in refused(recorder.recording().to_mat, tmp_path / "all.mat")


def test_rows_are_on_disk_after_half_a_second(tmp_path, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    recorder = Recorder(tmp_path, COLUMNS, METADATA)
    while not (tmp_path / "recording.arrows").stat().st_size:  # a thread writes its head
        time.sleep(0.01)
    for tick in range(100):
        clock[0] += 0.05
        recorder.append(make_rows(1, tick))
        lost = tick + 1 - Recording.open(tmp_path).rows
        assert lost * 0.05 <= 0.5
    recorder.close(complete=True)


@pytest.mark.parametrize("name", ["recording.arrows", "recording.parquet"])
def test_an_older_recording_is_not_written_over(tmp_path, name):
    (tmp_path / name).write_text("precious")
    with pytest.raises(InputError, match=f"{name}: already exists"):
        Recorder(tmp_path, COLUMNS, METADATA)
    assert (tmp_path / name).read_text() == "precious"
    with pytest.raises(InputError, match="cannot be written to: "):
        Recorder(tmp_path / name / "run", COLUMNS, METADATA)


def test_the_rows_before_a_full_disk_are_kept(tmp_path):
    recorder, old = Recorder(tmp_path, COLUMNS, METADATA), resource.getrlimit(resource.RLIMIT_FSIZE)
    recorder.append(make_rows(10))
    recorder.flush()
    size = (tmp_path / "recording.arrows").stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, old[1]))
    try:
        recorder.append(make_rows(10, 10))
        with pytest.raises(SimulationError, match="after 10 rows, which are kept: File too large"):
            recorder.flush()
        recording = Recording.open(recorder.close(complete=False))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
    np.testing.assert_array_equal(all_columns(recording), make_rows(10))
    assert not recording.complete


# --- Damaged files ---------------------------------------------------------------------------


def test_a_stream_cut_anywhere_gives_all_its_whole_batches(tmp_path):
    path = interrupted(tmp_path)
    content = path.read_bytes()
    whole = np.concatenate([make_rows(10, 10 * k) for k in range(3)])
    rows_seen = set()
    for size in range(0, len(content), 61):
        path.write_bytes(content[:size])
        try:
            recording = Recording.open(path)
        except InputError as error:
            assert str(error).startswith(f"{path}: is not an Arrow stream")  # noqa: PT017
            continue
        assert np.array_equal(all_columns(recording), whole[: recording.rows])
        assert recording.complete is False
        rows_seen.add(recording.rows)
    assert rows_seen == {0, 10, 20}


@pytest.mark.parametrize("name", ["recording.parquet", "recording.arrows"])
@pytest.mark.parametrize(
    "content", [b"", b"PAR1", b"PAR1" + b"\0" * 100 + b"PAR1", b"\xff" * 200, b"time,x\n0,1\n"]
)
def test_what_is_not_a_recording_is_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name) as caught:
        Recording.open(tmp_path)
    assert str(caught.value).isprintable()


FOREIGN = [
    (["time"], None, "is not a recording of panda-cosim"),
    (["time"], "{", "is damaged"),
    (["time"], "[]", "format None; must be 1"),
    (["time"], '{"format": 2, "complete": true}', "format 2; must be 1"),
    ([], '{"format": 1, "complete": true}', "the first column is not time"),
]


@pytest.mark.parametrize("suffix", [".parquet", ".arrows"])
@pytest.mark.parametrize(("names", "metadata", "expected"), FOREIGN)
def test_a_foreign_or_other_version_is_refused(tmp_path, suffix, names, metadata, expected):
    fields = [pa.field(name, pa.float64()) for name in names]
    schema = pa.schema(fields, metadata={} if metadata is None else {"panda_cosim": metadata})
    path = tmp_path / f"recording{suffix}"
    if suffix == ".parquet":
        pq.write_table(schema.empty_table(), path)
    else:
        pa.ipc.new_stream(path, schema).close()
    with pytest.raises(InputError, match=expected):
        Recording.open(path)


@pytest.mark.parametrize(
    ("step", "expected"),
    [
        (-1e-3, "time: value -0.001 in row 2; must increase from row to row"),
        (0.0, "time: value 0.0 in row 2; must increase"),
        (math.inf, "time: value nan in row 1; must increase"),
    ],
)
def test_a_time_that_does_not_increase_is_refused_where_it_matters(tmp_path, step, expected):
    with np.errstate(invalid="ignore"):
        rows = (step * np.arange(5.0))[:, None] * np.ones(WIDTH)
    record(tmp_path, rows)
    assert Recording.open(tmp_path).rows == 5
    with pytest.raises(InputError, match=expected):
        Recording.open(tmp_path, in_order=True)


@given(st.data(), st.booleans())
def test_flipped_bits_are_reported_or_change_no_number(tmp_path_factory, data, is_whole):
    """In a stream, and in what Parquet has no checksum of, they may; but there is no traceback."""
    folder = tmp_path_factory.mktemp("run")
    path = record(folder, make_rows(50)) if is_whole else interrupted(folder)
    content = bytearray(path.read_bytes())
    footer = len(content) - int.from_bytes(content[-8:-4], "little") - 8 if is_whole else 0
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    try:
        recording = Recording.open(path)
        values = all_columns(recording)
        assert all(len(recording[name]) == recording.rows for name in recording)
    except InputError as error:
        assert str(error).isprintable()  # noqa: PT017  # most flips are found, not all matter
    else:
        assert place >= footer or np.array_equal(values, make_rows(50))


def test_a_recording_is_read_without_pandas(tmp_path):
    record(tmp_path, make_rows(3))
    code = (
        "import sys; sys.modules['pandas'] = None  # as if it were not installed\n"
        "from panda_cosim import Recording; print(Recording.open(sys.argv[1])['time'][2])"
    )
    assert ran([sys.executable, "-c", code, tmp_path]).stdout == "0.002\n"


@pytest.mark.parametrize("name", ["~/run", "file:x", "x?y=1#z"])
def test_paths_are_taken_literally(tmp_path, monkeypatch, name):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    record(tmp_path / "home" / "run", make_rows(7))
    folder = Path(name)
    with Recorder(folder, COLUMNS, METADATA) as recorder:
        recorder.append(make_rows(3))
        recorder.flush()
        assert Recording.open(folder).rows == 3
        recorder.close(complete=True)
    assert Recording.open(folder).rows == 3
    assert (tmp_path / name / "recording.parquet").is_file()


def test_a_short_recording_is_read_from_memory_while_its_file_is_made(tmp_path, monkeypatch):
    may_go_on, plain = threading.Event(), storage.write_parquet

    def slow(*arguments: object) -> None:
        assert may_go_on.wait(60)
        plain(*arguments)

    monkeypatch.setattr(storage, "write_parquet", slow)
    rows = make_rows(50)
    recorder = Recorder(tmp_path, COLUMNS, METADATA)
    recorder.append(rows)
    recorder.end(complete=True)
    early = recorder.recording()
    assert early is not None
    assert (all_columns(early) == rows).all()
    assert not (tmp_path / "recording.parquet").exists()
    may_go_on.set()
    assert recorder.close(complete=False) == tmp_path / "recording.parquet"
    assert Recording.open(tmp_path).complete
    assert (all_columns(Recording.open(tmp_path)) == rows).all()
