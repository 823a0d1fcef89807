"""LLFF's poses_bounds.npy."""

import numpy as np

from airgs_codec.train.data.readers import open_scene
from tests.support.multiview_files import plain, same_camera, write_video
from tests.support.views import ring


def test_camera_videos_with_llff_poses(tmp_path):
    for i, camera in enumerate(ring(3)):
        c2w = np.linalg.inv(camera.world_to_camera)
        columns = [c2w[:3, 1], c2w[:3, 0], -c2w[:3, 2], c2w[:3, 3], np.array([48, 48, camera.fx])]
        row = np.concatenate([np.stack(columns, axis=1).ravel(), [0.1, 100]])
        np.save(tmp_path / f"row{i}.npy", row)
        write_video(tmp_path / f"cam{i:02d}.mp4", [plain(60 + 60 * t, (48, 48)) for t in range(2)])
    np.save(tmp_path / "poses_bounds.npy", np.stack([np.load(tmp_path / f"row{i}.npy") for i in range(3)]))
    scene = open_scene(tmp_path)
    assert len(scene) == 2
    assert all(same_camera(a, b) for a, b in zip(scene.cameras, ring(3), strict=True))
