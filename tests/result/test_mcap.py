"""`export RUN x.mcap`: another program's reader finds what was recorded."""

import io
import json
import struct

import pytest

from panda_cosim.cli.commands.render import export
from panda_cosim.run.execution import run_scenario
from panda_cosim.task.scenario import load_scenario

reader = pytest.importorskip("mcap.reader")
messages = pytest.importorskip("foxglove.messages")
RATE = 50.0  # [Hz]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "run"
    return run_scenario(load_scenario("push"), folder)


@pytest.fixture(scope="module")
def found(run):
    """Messages by topic: instant [ns] and content, decoded where it is JSON."""
    path = run.folder / "run.mcap"
    export(run.folder, path, rate=RATE, overwrite=False)
    topics = {}
    with path.open("rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages():
            is_json = channel.message_encoding == "json"
            content = json.loads(message.data) if is_json else (schema.name, message.data)
            topics.setdefault(channel.topic, []).append((message.log_time, content))
    return topics


def fields(data):
    """Yield the fields of a protobuf message: doubles, and bytes of texts and of messages."""
    stream = io.BytesIO(data)

    def number():
        byte = stream.read(1)[0]
        return byte if byte < 128 else byte - 128 + 128 * number()

    while stream.tell() < len(data):
        field, kind = divmod(number(), 8)
        if kind == 1:
            yield field, struct.unpack("<d", stream.read(8))[0]
        else:
            yield field, stream.read(number()) if kind == 2 else number()


def test_topics_have_foxgloves_messages_at_the_rate_asked_for(run, found):
    names = {"/tf": "foxglove.FrameTransforms", "/joint_states": "foxglove.JointStates",
             "/scene": "foxglove.SceneUpdate", "/log": "foxglove.Log"}  # fmt: skip
    assert {topic: found[topic][0][1][0] for topic in names} == names
    instants = [at for at, _ in found["/tf"]]
    assert instants == [round(time * 1e9) for time in run.recording.time[::20]]
    assert [at for at, _ in found["/plant"]] == instants == [at for at, _ in found["/joint_states"]]
    assert len(found["/scene"]) == 1
    texts = [dict(fields(data))[3].decode() for _, (_, data) in found["/log"]]
    assert run.summary.brief in texts


def test_signals_are_those_that_were_recorded(run, found):
    for instance, name in (("plant", "qpos[3]"), ("controller", "ctrl[2]")):
        told = [values[name] for _, values in found[f"/{instance}"]]
        assert told == run.recording[f"{instance}.{name}"][::20].tolist()


def test_frames_are_where_the_plant_says_that_the_hand_is(run, found):
    recording = run.recording
    for row, (_, (_, data)) in zip(range(0, recording.rows, 20), found["/tf"], strict=True):
        transforms = [dict(fields(part)) for _, part in fields(data)]
        (transform,) = (each for each in transforms if each[3] == b"hand")
        place = [value for _, value in fields(transform[4])]
        turn = [dict(fields(transform[5])).get(key, 0.0) for key in (4, 1, 2, 3)]  # w, x, y, z
        assert place == pytest.approx(recording["plant.hand_xpos"][row], abs=1e-9)
        assert turn == pytest.approx(recording["plant.hand_xquat"][row], abs=1e-9)
