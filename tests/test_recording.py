"""Laws of recordings and of their channels."""

import numpy as np
import pytest
from made_up import recording

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError


def test_native_column_is_name_and_suffix():
    assert CHANNELS["a_x"].column == "a_x_mps2"
    assert all(name == channel.name for name, channel in CHANNELS.items())


def test_a_recording_refuses_unknown_channels():
    rec = recording()
    with pytest.raises(InputError, match="unknown channel 'ay'"):
        Recording(**{**vars(rec), "channels": {"ay": rec.t}, "valid": {"ay": rec.t > 0}})


def test_a_recording_is_shown_as_a_row_a_channel_with_what_was_noted():
    t = np.arange(4) / 10.0
    speed, absent = np.array([1.0, 2.0, 99.0, 3.0]), np.full(4, np.nan)
    rec = Recording(
        name="a <b>", rate=10.0, t=t, channels={"v_x": speed, "a_y": absent}, groups={}, source="a.csv",
        valid={"v_x": speed < 50.0, "a_y": np.zeros(4, bool)}, notes=("v_x: 1 spike < flagged",),
    )  # fmt: skip
    speed_row, absent_row = rec.table.to_dict("records")
    shown = {"channel": "v_x", "unit": "m/s", "group": "can", "measured": 0.75, "least": 1.0, "most": 3.0}
    assert speed_row == shown
    assert absent_row["measured"] == 0.0
    assert np.isnan([absent_row["least"], absent_row["most"]]).all()
    text, page = repr(rec), rec._repr_html_()
    assert text.splitlines()[0] == "a <b>: 0.4 s at 10 Hz"
    assert text.splitlines()[-1] == "v_x: 1 spike < flagged"
    assert "a &lt;b&gt;: 0.4 s" in page
    assert "<p>v_x: 1 spike &lt; flagged</p>" in page
