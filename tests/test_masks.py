"""Laws of the parts of a recording: what is held out, and what of a long one is used."""

import numpy as np
import pytest
from made_up import in_windows, recording

from vehicle_sbi.data.masks import holdout, liveliest
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError


def test_holdout_parts_share_no_sample_and_keep_their_distance():
    rec = recording(60.0)
    training, held = holdout(rec, share=0.25, block_s=5.0, buffer_s=1.0)
    a, b = training.valid["a_y"], held.valid["a_y"]
    assert not (a & b).any()
    assert b.mean() == pytest.approx(0.25)
    distance = np.abs(np.flatnonzero(a)[:, None] - np.flatnonzero(b)[None, :]).min()
    assert distance == 101
    assert all(np.isnan(values[~a]).all() for values in training.channels.values())
    assert "held out" in training.notes[-1]
    assert not any("without an input" in note for note in in_windows(training).notes)  # it is there, but held out
    assert in_windows(held).valid.any()


def test_holdout_of_a_short_recording_has_both_parts():
    training, held = holdout(recording(4.0), share=0.25, buffer_s=0.1)
    assert training.valid["a_y"].any()
    assert held.valid["a_y"].any()


def test_impossible_splits_are_refused():
    rec = recording()
    with pytest.raises(InputError, match="0 < share < 1"):
        holdout(rec, share=1.5)
    with pytest.raises(InputError, match="leaves nothing to train on"):
        holdout(rec, buffer_s=100.0)


def test_of_a_long_recording_the_liveliest_stretches_are_kept() -> None:
    # Ten minutes; the fourth is steered, the eighth is braked, and in the sixth steering is not known.
    t = np.arange(6000) / 10.0
    minute = (t // 60.0).astype(int)
    channels = {
        "steering": np.where(minute == 3, 0.1 * np.sin(t), 0.0) + np.where(minute == 5, np.nan, 0.0),
        "v_x": 20.0 - np.where(minute == 7, np.minimum(t - 420.0, 5.0), 0.0),
        "a_y": np.cos(t),
    }
    valid = {name: np.isfinite(values) for name, values in channels.items()}
    whole = Recording(name="x", rate=10.0, t=t, channels=channels, valid=valid, groups={}, source="x")
    kept = liveliest(whole, 0.2)
    assert set(minute[kept.valid["a_y"]]) == {3, 7}
    assert kept.present_s == 120.0
    assert kept.notes[-1] == "20% of the time used: where steering and speed change most"
    assert liveliest(whole, 1.0) is whole


def test_of_a_recording_with_the_wheels_alone_the_liveliest_stretches_are_kept_too() -> None:
    t = np.arange(6000) / 10.0
    minute = (t // 60.0).astype(int)
    channels = {
        "steering_wheel": np.where(minute == 3, np.sin(t), 0.0),
        "wheel_speed_rear": np.where(minute == 7, t, 60.0),
    }
    valid = {name: np.isfinite(values) for name, values in channels.items()}
    whole = Recording(name="x", rate=10.0, t=t, channels=channels, valid=valid, groups={}, source="x")
    assert set(minute[liveliest(whole, 0.2).valid["steering_wheel"]]) == {3, 7}
