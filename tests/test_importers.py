"""fishsim marker files: a known path comes back, slips are found, real files have known speeds."""

import numpy as np
import pytest

from tailbeat.files import BadInput
from tailbeat.importers.fishsim import import_fishsim
from tailbeat.recording import markers

PLACES = np.array([77, -65, -280, -299.5, -329.5, -361.5, -390.5, -411.5, -474]) * 1e-3
# Mean over frames of head velocity along the heading [m/s], measured apart from this code.
SPEEDS = {
    "f0_50": 0.023,
    "f0_75": 0.050,
    "f1_00": 0.081,
    "f1_50": 0.130,
    "f1_75": 0.161,
    "f2_25": 0.223,
}


def filmed(speed: float, slip: bool) -> np.ndarray:
    """A rigid fish swimming straight at 30 degrees, as pixels with y down."""
    frames = np.arange(240) / 60
    heading = np.radians(30)
    along = speed * frames[:, None] + PLACES
    x, y = along * np.cos(heading), along * np.sin(heading)
    pixels = np.stack([500 + x / 0.00105, 800 - y / 0.00105], axis=-1)
    if slip:
        pixels[50:90, 4] = pixels[50:90, 5]  # the tracker jumps to the neighbour
    return pixels.reshape(240, -1)


def test_a_known_swim_comes_back(tmp_path):
    np.savetxt(tmp_path / "a.csv", filmed(0.15, slip=False), delimiter=",")
    recording = import_fishsim(tmp_path / "a.csv")
    assert recording.columns["x_m"][-1] == pytest.approx(0.15 * 239 / 60, rel=1e-3)
    assert np.abs(recording.columns["y_m"]).max() < 1e-6
    assert np.abs(recording.columns["yaw_rad"]).max() < 1e-6
    tracks, _ = markers(recording)
    assert np.allclose(tracks[0, :, 0] - tracks[0, 0, 0], PLACES - PLACES[0], atol=1e-3)


def test_a_slipped_marker_is_unseen_and_the_others_kept(tmp_path):
    np.savetxt(tmp_path / "a.csv", filmed(0.15, slip=True), delimiter=",")
    tracks, _ = markers(import_fishsim(tmp_path / "a.csv"))
    unseen = np.isnan(tracks[..., 0])
    assert unseen[50:90, 4].all()
    assert unseen.sum() == 40


@pytest.mark.parametrize("run", SPEEDS)
def test_real_runs_have_their_known_speed(data, run):
    recording = import_fishsim(data / "fishsim" / f"markers_{run}.csv")
    pose = np.stack([recording.columns[n] for n in ("x_m", "y_m", "yaw_rad")], axis=1)
    rate = np.gradient(pose[:, :2], recording.time, axis=0)
    speed = (rate[:, 0] * np.cos(pose[:, 2]) + rate[:, 1] * np.sin(pose[:, 2])).mean()
    assert speed == pytest.approx(SPEEDS[run], abs=0.003)


def test_real_slips_are_found(data):
    tracks, _ = markers(import_fishsim(data / "fishsim" / "markers_f1_50.csv"))
    late = np.isnan(tracks[20:, :, 0]).mean(axis=0)
    assert max(late[4], late[5]) > 0.9 and max(late[6], late[7]) > 0.9
    assert late[[0, 1, 2, 3, 8]].max() == 0
    clean, _ = markers(import_fishsim(data / "fishsim" / "markers_f1_00.csv"))
    assert np.isnan(clean).mean() < 0.005


def test_bad_files_are_refused(tmp_path):
    (tmp_path / "narrow.csv").write_text("1,2\n3,4\n")
    with pytest.raises(BadInput, match="2 rows of 2 columns"):
        import_fishsim(tmp_path / "narrow.csv")
    pixels = filmed(0.1, slip=False).astype(object)
    pixels[3, 2] = "nan"
    np.savetxt(tmp_path / "nan.csv", pixels, delimiter=",", fmt="%s")
    with pytest.raises(BadInput, match="row 4, column 3"):
        import_fishsim(tmp_path / "nan.csv")
    lost = filmed(0.1, slip=False)
    lost[0, 0] += 400  # the head's front marker is elsewhere in the first frame
    np.savetxt(tmp_path / "lost.csv", lost, delimiter=",")
    with pytest.raises(BadInput, match=r"lost\.csv: row 1: head marker 0 jumps"):
        import_fishsim(tmp_path / "lost.csv")
    np.savetxt(tmp_path / "same.csv", np.zeros((50, 18)), delimiter=",")
    with pytest.raises(BadInput, match=r"same\.csv: head markers 0 and 1 coincide"):
        import_fishsim(tmp_path / "same.csv")
