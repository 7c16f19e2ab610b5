"""Motion vectors: what a pixel shows was there, one frame ago."""

from __future__ import annotations

import numpy as np
import pytest

from lambent.errors import DamagedFileError, OptionError, UnknownNameError
from lambent.frame.role import Role
from lambent.kernels.warp import warp
from lambent.render.variant import mitsuba

mi = mitsuba()

from lambent.render.animation import (
    Keyframes,
    Pose,
    Stage,
    disoccluded,
    look_at,
    read_keyframes,
)
from lambent.render.sampling import FrameSampler

from . import scenes


def animation(frame: float) -> Pose:
    """Camera, ball and box move, a few pixels a frame."""
    turn = np.eye(4)
    angle = 0.05 * frame
    turn[:3, :3] = [
        [np.cos(angle), 0, np.sin(angle)],
        [0, 1, 0],
        [-np.sin(angle), 0, np.cos(angle)],
    ]
    shift = np.eye(4)
    shift[:3, 3] = [0.07 * frame, 0.03 * frame, 0]
    camera = look_at([0.06 * frame, 0.02 * frame, 6 - 0.05 * frame], [0, 0, 0], [0, 1, 0])
    return Pose(camera, None, {"ball": shift, "box": turn})


@pytest.fixture(scope="module")
def pair():
    """Frames 4 and 5 of `animation`, and the sampler's stage."""
    scene = scenes.moving(mi)
    stage = Stage(mi, scene, scene.sensors()[0], animation)
    frames = []
    for number in (4, 5):
        motion = stage.motion(number, number - 1)
        frames.append(FrameSampler(scene, depth=2, motion=motion).sample(64, seed=number).frame())
    return frames


def test_warped_albedo_and_position_are_those_of_the_frame(pair):
    before, now = pair
    hidden = disoccluded(now, before)
    assert 0.002 < hidden.mean() < 0.1
    albedo, inside = warp(before["albedo"], now[Role.MOTION])
    shown = inside & ~hidden
    assert shown.mean() > 0.85
    apart = np.abs(albedo - now["albedo"]).mean(axis=2)
    # The albedo changes by so much over a pixel: the error in pixels is their quotient.
    slope = np.hypot(*np.gradient(now["albedo"].mean(axis=2)))
    steep = shown & (slope > 0.02)
    assert steep.sum() > 300
    assert np.median(apart[steep] / slope[steep]) < 0.1
    # The wall stands still: its points carried back are where they are, to a tenth of a pixel.
    wall = shown & (now["position"][..., 2] < -1.9)
    position, _ = warp(before["position"], now[Role.MOTION])
    step = np.abs(np.gradient(now["position"][..., 0], axis=1))[wall]
    error = np.linalg.norm(position - now["position"], axis=2)[wall]
    assert np.median(error) < 0.1 * np.median(step)


def test_disoccluded_pixels_are_flagged(pair):
    """Where the flag is set the warped albedo is wrong; it is set beside the moving things."""
    before, now = pair
    hidden = disoccluded(now, before)
    albedo, inside = warp(before["albedo"], now[Role.MOTION])
    wrong = np.abs(albedo - now["albedo"]).mean(axis=2)
    assert wrong[hidden & inside].mean() > 5 * np.median(wrong[~hidden & inside])


def test_motion_is_nought_where_nothing_moves():
    scene = scenes.moving(mi, 32)
    stage = Stage(mi, scene, scene.sensors()[0], lambda frame: Pose())
    frame = FrameSampler(scene, depth=2, motion=stage.motion(3, 2)).sample(4, seed=1).frame()
    assert np.abs(frame[Role.MOTION]).max() < 2e-3
    assert not disoccluded(frame, frame).any()


def test_motion_of_a_known_shift_is_exact():
    """The camera slides one unit along x before a wall at distance 8: all pixels by the same."""
    scene = scenes.moving(mi, 64)

    def slide(frame: float) -> Pose:
        return Pose(look_at([frame, 0, 6], [frame, 0, 0], [0, 1, 0]), None, {})

    stage = Stage(mi, scene, scene.sensors()[0], slide)
    frame = FrameSampler(scene, depth=2, motion=stage.motion(1, 0)).sample(4, seed=1).frame()
    wall = frame["position"][..., 2] < -1.9
    # A pixel is 2 tan(20°) 8 / 64 wide at the wall. Mitsuba's camera has +x on the left.
    expected = 1 / (2 * np.tan(np.radians(20)) * 8 / 64)
    moved = frame[Role.MOTION][wall]
    np.testing.assert_allclose(np.abs(moved[:, 0]), expected, rtol=1e-3)
    np.testing.assert_allclose(moved[:, 1], 0, atol=1e-3)
    # What the camera passes by moves against it: it was further to the right before.
    left = np.array(mi.traverse(scene.sensors()[0])["to_world"].matrix).reshape(4, 4)[0, 0]
    assert np.sign(moved[:, 0].mean()) == -np.sign(left)


def test_background_moves_with_the_cameras_turn():
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "fov": 40, "film": scenes.film(32)},
            "sky": {"type": "constant"},
        }
    )

    def turn(frame: float) -> Pose:
        angle = np.radians(2.0) * frame
        return Pose(look_at([0, 0, 0], [np.sin(angle), 0, np.cos(angle)], [0, 1, 0]))

    stage = Stage(mi, scene, scene.sensors()[0], turn)
    frame = FrameSampler(scene, depth=2, motion=stage.motion(1, 0)).sample(4, seed=1).frame()
    middle = frame[Role.MOTION][15:17, 15:17, 0].mean()
    assert abs(middle) == pytest.approx(
        np.tan(np.radians(2)) * 16 / np.tan(np.radians(20)), rel=0.02
    )


KEYS = """
frames = [1, 9]
[camera]
at = [1, 5, 9]
origin = [[0, 0, 5], [1, 0, 5], [1, 1, 5]]
target = [0, 0, 0]
fov = [40, 40, 30]
[[object]]
shape = "ball"
at = [1, 9]
translate = [[0, 0, 0], [2, 0, 0]]
interpolation = "linear"
"""


def test_keyframes_go_through_their_keys(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(KEYS)
    keys = read_keyframes(path)
    assert keys.frames == tuple(range(1, 10))
    np.testing.assert_allclose(keys(5).camera[:3, 3], [1, 0, 5], atol=1e-12)
    assert keys(9).fov == 30
    np.testing.assert_allclose(keys(3).shapes["ball"][:3, 3], [0.5, 0, 0])
    # Before the first and after the last key nothing moves.
    np.testing.assert_allclose(keys(0).camera, keys(1).camera)
    np.testing.assert_allclose(keys(12).shapes["ball"][:3, 3], [2, 0, 0])
    # Smooth: the speed at a key is the same from both sides.
    h = 1e-4
    before = keys(5).camera[:3, 3] - keys(5 - h).camera[:3, 3]
    after = keys(5 + h).camera[:3, 3] - keys(5).camera[:3, 3]
    np.testing.assert_allclose(before, after, atol=1e-3 * h)


@pytest.mark.parametrize(
    ("text", "error", "word"),
    [
        ("frames = [1", DamagedFileError, "TOML"),
        ("frames = [3, 1]", OptionError, "frames"),
        ("frames = [1, 2]\nspeed = 3", UnknownNameError, "speed"),
        ("frames = [1, 2]\n[camera]\norigin = [0, 0, 1]", OptionError, "target"),
        ("frames = [1, 2]\n[[object]]\nat = [1]", OptionError, "shape"),
        ("frames = [1, 2]\n[camera]\nat = [2, 1]", OptionError, "rise"),
    ],
)
def test_bad_keyframes_are_told(tmp_path, text, error, word):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(error, match=word):
        read_keyframes(path)


def test_wrong_counts_and_shapes_are_told():
    keys = Keyframes({"frames": [1, 2], "camera": {"at": [1, 2, 3], "fov": [30.0, 40.0]}})
    with pytest.raises(OptionError, match="3 keyframes and 2 values"):
        keys(1)
    scene = scenes.moving(mi, 8)
    stage = Stage(mi, scene, scene.sensors()[0], lambda f: Pose(shapes={"bal": np.eye(4)}))
    with pytest.raises(UnknownNameError, match="bal"):
        stage.pose(1)
    with pytest.raises(OptionError, match="looks at where it stands"):
        look_at([1, 1, 1], [1, 1, 1], [0, 1, 0])
