"""Agreement of posed pictures through a depth map."""

import numpy as np
import pytest

from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.picture_agreement import PosedPicture, agreement, posed_picture

LENS = Intrinsics(96, 72, 80.0, 80.0, 48.0, 36.0)


def pictured(x: float, told: float = 0.0, contrast: float = 0.4, far: float = 5.0) -> PosedPicture:
    """Wall of stripes and dots two metres away, from `x` metres aside; the pose is `told` metres off."""
    pose = np.eye(4)
    pose[0, 3] = x
    place = Camera(LENS, pose).unproject(np.full(LENS.shape, 2.0))
    grey = 0.5 + contrast * np.sin(23 * place[..., 0] + np.sin(5 * place[..., 1])) * np.sin(19 * place[..., 1])
    pose[0, 3] += told
    camera = Camera(LENS, pose)
    reading = DepthReading(np.full(LENS.shape, 2.0, np.float32), camera)
    return posed_picture(np.repeat(grey[..., None], 3, axis=-1), camera, reading, far)


def test_right_poses_agree_and_wrong_ones_do_not() -> None:
    right = agreement(pictured(0.0), pictured(0.2))
    near, far = (agreement(pictured(0.0), pictured(0.2, told)) for told in (0.03, 0.12))
    assert right is not None and near is not None and far is not None
    assert right > 0.95 and far < 0.5 and right > near > far


def test_exposure_does_not_count() -> None:
    told = agreement(pictured(0.0), pictured(0.2, contrast=0.1))
    assert told is not None and told > 0.95


@pytest.mark.parametrize(
    ("second", "far"), [(pictured(5.0), 5.0), (pictured(0.2, contrast=0.0), 5.0), (pictured(0.2), 1.0)]
)
def test_where_little_is_common_nothing_is_told(second: PosedPicture, far: float) -> None:
    assert agreement(pictured(0.0, far=far), second) is None


def test_a_reading_without_confidence_does_not_count() -> None:
    reading = DepthReading(np.full(LENS.shape, 2.0, np.float32), pictured(0.0).camera, np.zeros(LENS.shape))
    first = posed_picture(np.zeros((*LENS.shape, 3)), reading.camera, reading, 5.0)
    assert not first.depth.any() and agreement(first, pictured(0.2)) is None


def test_what_stands_before_the_surface_hides_it() -> None:
    second = pictured(0.2)
    depth = second.reading.depth.copy()
    depth[:, :48] = 0.5
    hidden = agreement(pictured(0.0), second._replace(reading=second.reading._replace(depth=depth)))
    assert hidden is not None and hidden > 0.95
    depth[:] = 0.5
    assert agreement(pictured(0.0), second._replace(reading=second.reading._replace(depth=depth))) is None


def test_a_picture_is_moved_with_its_depth_map() -> None:
    pose = pictured(0.3).camera.pose
    moved = pictured(0.0).moved(pose)
    np.testing.assert_array_equal(moved.camera.pose, pose)
    np.testing.assert_array_equal(moved.reading.camera.pose, pose)
