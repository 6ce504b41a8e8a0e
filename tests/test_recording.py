"""Laws of recordings and of their channels."""

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
