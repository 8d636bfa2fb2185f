"""Calls of recordings that were written by hand."""

import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.recording.replay import checked_calls, replay
from gyrobench.drivers.recording.recording_file import read_recording

SET = "instrument: chamber\ncalls:\n- {ask: set_temperature, arguments: "


def written(tmp_path, text):
    path = tmp_path / "test.rec"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "instrument: chamber\ncalls:\n- ask: read\n- ask: limitsc\n---\n",
            r":4:3: call 2 of 2: .* mean 'limits_c'",
        ),
        ("instrument: chamber\ncalls:\n- ask: close\n---\n", r":3:3: call 1 of 1: a Chamber has no method"),
        ("instrument: table\ncalls:\n- ask: set_point_c\n---\n", r":3:3: .* RateTable has no method"),
        (
            "instrument: chamber\ncalls:\n- {ask: read, arguments: {x: 1}}\n---\n",
            r":3:15: .*unexpected keyword argument 'x'",
        ),
        (
            SET + "{temperature_c: warm, rate_c_per_min: 1}}\n---\n",
            r":3:.*set_temperature: 'temperature_c': .*number",
        ),
        (SET + "{temperature_c: 20}}\n---\n", r":3:.* missing a required argument: 'rate_c_per_min'"),
        (
            "instrument: table\ncalls:\n- {ask: turn_at, arguments: {axis: 3, rate_dps: 1}}\n---\n",
            r":3:18: .* there is no axis 3, only \[1, 2\]",
        ),
        (
            "instrument: table\ncalls:\n- {ask: move_to, arguments: {angles_deg: 3, rate_dps: 1}}\n---\n",
            r":3:30: call 1 of 1: move_to: 'angles_deg': .*dictionary",
        ),
        (
            "instrument: table\ncalls:\n- {ask: move_to, arguments: {angles_deg: {}, rate_dps: 1}}\n---\n",
            r":3:30: call 1 of 1: move_to: names no axis",
        ),
    ],
)
def test_a_call_that_can_not_be_made_is_reported_with_its_place(tmp_path, text, message):
    with pytest.raises(DocumentError, match=rf"test\.rec{message}"):
        replay(written(tmp_path, text))


def test_calls_that_can_be_made_are_read(tmp_path):
    calls = "- {ask: set_temperature, arguments: {temperature_c: 20, rate_c_per_min: null}}\n"
    text = f"instrument: chamber\ncalls:\n{calls}---\n"
    assert checked_calls(read_recording(written(tmp_path, text)))[0].arguments["temperature_c"] == 20
    calls = "- {ask: move_to, arguments: {angles_deg: {1: 30, 2: 1.5}, rate_dps: 10}}\n"
    text = f"instrument: table\ncalls:\n{calls}---\n"
    assert checked_calls(read_recording(written(tmp_path, text)))[0].arguments == {
        "angles_deg": {1: 30.0, 2: 1.5},
        "rate_dps": 10.0,
    }
