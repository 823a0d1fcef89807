"""Rigs without poses: a folder of videos that cameras filmed at the same time, and the poses found from one moment.

Poses come by structure from motion, COLMAP (Schoenberger and Frahm 2016) through pycolmap. Cameras of a rig are few and
far apart, and there is one picture of each. So features keep their affine shape and are pooled over sizes (DSP-SIFT,
Dong and Soatto 2015), and fewer matches suffice for a pose than in COLMAP's defaults, which are for photographs by the
thousand.
"""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.media.image import write_png
from airgs_codec.media.movie import VideoReader
from airgs_codec.progress import Progress, silent
from airgs_codec.trainer.data.videos import find_videos

FEWEST = 3  # cameras with a pose


@dataclass(frozen=True, slots=True)
class RigCamera:
    """The pose of one camera in figures: whether it has one, and what it rests on."""

    name: str
    posed: bool
    features: int  # in its picture
    matches: int  # of its features, summed over the cameras that it shares a geometry with
    neighbours: int  # these cameras
    points: int  # that its pose rests on; 0 without one
    error: float | None  # pixels, mean reprojection error of these points; None without a pose


@dataclass(frozen=True, slots=True)
class RigReport:
    """The poses of a rig in figures."""

    cameras: tuple[RigCamera, ...]
    points: int
    error: float  # pixels, mean reprojection error of all points

    @property
    def failed(self) -> list[RigCamera]:
        """The cameras without a pose."""
        return [camera for camera in self.cameras if not camera.posed]

    def summary(self) -> str:
        """The whole in a line."""
        posed = len(self.cameras) - len(self.failed)
        return f"{posed} of {len(self.cameras)} cameras have poses, {self.points:,} points, {self.error:.2f} px"

    def lines(self) -> list[str]:
        """A line for each camera."""
        return [_line(camera) for camera in self.cameras]


def has_rig(folder: Path) -> bool:
    """Whether the folder has several videos, in itself or in videos/."""
    return len(rig_videos(folder)) > 1


def rig_videos(folder: Path) -> list[Path]:
    """The videos of a rig by name, one a camera."""
    return find_videos(folder / "videos") or find_videos(folder)


def read_rig(folder: Path) -> NoReturn:
    """Raises SceneError: the poses must be found first."""
    count = len(rig_videos(folder))
    raise SceneError(f"{folder}: expected poses of {count} cameras, got videos alone: airgs-train finds them")


def _line(c: RigCamera) -> str:
    seen = f"{c.features:,} features, {c.matches:,} matches with {c.neighbours} cameras"
    if c.error is None:
        return f"{c.name}: no pose, {seen}"
    return f"{c.name}: {seen}, {c.points:,} points, {c.error:.2f} px"


LENS_MODEL = "SIMPLE_RADIAL"  # one focal length, one coefficient: what one picture of a camera can tell
LONGEST = 2000  # pixels of a side on which features are looked for
RATIO = 0.8  # of the distances to the best and the second match
FIRST_INLIERS = 30  # matches of the pair that the rest is built on
# Matches that a pose must explain. On a real dome with repeating panels 12 of 27 cameras had a pose so, each
# within 4 degrees. What placed 26 or 27 (10 matches; guided matching) had many wrong, at errors of a pixel or less.
POSE_INLIERS = 15
MOST_SECONDS = 600  # for the poses
SEED = 0


def find_poses(folder: Path, *, frame: int = 0, shared_lens: bool = False, progress: Progress = silent) -> RigReport:
    """Find the poses of a rig's cameras from what they filmed at `frame`, and write them to sparse/0 beside the videos.

    `shared_lens`: all cameras have the same one; otherwise each has its own. Axes and unit of length are COLMAP's, any.
    Cameras that cannot be placed are left out and named in the report.

    Raises ConfigError without pycolmap or where sparse/ is there already; SceneError for videos that cannot be read, or
    where fewer than half of the cameras, or FEWEST, have poses: then nothing is written.
    """
    if importlib.util.find_spec("pycolmap") is None:
        raise ConfigError("finding poses of cameras needs pycolmap: pip install 'airgs-codec[rigs]'")
    if (folder / "sparse").exists():
        raise ConfigError(f"{folder / 'sparse'}: expected no poses yet; remove it to find them again")
    videos = _checked(folder, rig_videos(folder))
    with tempfile.TemporaryDirectory(prefix=".poses-", dir=folder) as name:
        work = Path(name)
        _write_pictures(work, videos, frame, shared_lens, progress)
        pictures = [f"{video.stem}.png" for video in videos]
        _find_features(work, pictures, shared_lens, progress)
        _match(work, pictures, progress)
        best = _place(work, len(videos), progress)
        report = _report(work, best)
        least = max(FEWEST, -(-len(videos) // 2))
        posed = len(videos) - len(report.failed)
        if posed < least:
            failed = ", ".join(camera.name for camera in report.failed)
            expected = f"expected poses of at least {least} of {len(videos)} cameras"
            raise SceneError(f"{folder}: {expected} from frame {frame}, got {posed}; none of {failed}")
        (work / "sparse" / "0").mkdir(parents=True)
        best.write_binary(str(work / "sparse" / "0"))
        (work / "sparse").rename(folder / "sparse")
    return report


def _checked(folder: Path, videos: list[Path]) -> list[Path]:
    """The videos, if there are enough of them with names of their own. Raises SceneError."""
    if len(videos) < FEWEST:
        raise SceneError(f"{folder}: expected videos of at least {FEWEST} cameras, got {len(videos)}")
    stems = [video.stem for video in videos]
    if twice := sorted({stem for stem in stems if stems.count(stem) > 1}):
        raise SceneError(f"{folder}: expected one video for each camera, got several of {', '.join(twice)}")
    return videos


def _write_pictures(work: Path, videos: Sequence[Path], frame: int, shared_lens: bool, progress: Progress) -> None:
    """Write what each camera filmed at a frame, as CAM.png."""
    (work / "images").mkdir()
    sizes: dict[tuple[int, int], Path] = {}
    for done, video in enumerate(videos, start=1):
        reader = VideoReader(video)
        sizes.setdefault(reader.size, video)
        if shared_lens and len(sizes) > 1:
            raise SceneError(f"{video}: expected videos of one size for one lens, got {[*sizes]}")
        write_png(work / "images" / f"{video.stem}.png", reader.read(frame))
        reader.close()
        progress("pictures", done, len(videos))


def _find_features(work: Path, pictures: Sequence[str], shared_lens: bool, progress: Progress) -> None:
    import pycolmap

    pycolmap.logging.minloglevel = 3  # what matters is in the report
    pycolmap.set_random_seed(SEED)
    found = pycolmap.FeatureExtractionOptions(max_image_size=LONGEST)
    found.sift.estimate_affine_shape = found.sift.domain_size_pooling = True
    reader = pycolmap.ImageReaderOptions(camera_model=LENS_MODEL)
    for done, picture in enumerate(pictures, start=1):
        pycolmap.extract_features(
            work / "database.db",
            work / "images",
            [picture],
            pycolmap.CameraMode.SINGLE if shared_lens else pycolmap.CameraMode.PER_IMAGE,
            reader_options=reader,
            extraction_options=found,
            device=pycolmap.Device.cpu,
        )
        if shared_lens:
            reader.existing_camera_id = 1  # that of the first picture
        progress("features", done, len(pictures))


def _match(work: Path, pictures: Sequence[str], progress: Progress) -> None:
    """Match every picture with all before it."""
    import pycolmap

    options = pycolmap.FeatureMatchingOptions()
    options.sift.max_ratio = RATIO
    pairs = work / "pairs.txt"
    for done in range(1, len(pictures)):
        pairs.write_text("".join(f"{pictures[done]} {other}\n" for other in pictures[:done]), encoding="utf-8")
        pycolmap.match_image_pairs(
            work / "database.db",
            matching_options=options,
            pairing_options=pycolmap.ImportedPairingOptions(match_list_path=pairs),
            device=pycolmap.Device.cpu,
        )
        progress("matches", done * (done + 1) // 2, len(pictures) * (len(pictures) - 1) // 2)


def _place(work: Path, count: int, progress: Progress) -> Any:
    """The reconstruction with the most cameras; None where there is none."""
    found = _reconstruct(work, _options(), count, progress)
    return max(found, key=lambda model: (model.num_reg_images(), model.num_points3D()), default=None)


def _options() -> Any:
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions(
        min_model_size=FEWEST, min_num_matches=POSE_INLIERS, max_runtime_seconds=MOST_SECONDS, random_seed=SEED
    )
    options.mapper.init_min_num_inliers = FIRST_INLIERS
    options.mapper.abs_pose_min_num_inliers = POSE_INLIERS
    options.structure_less_registration_fallback = False  # may take minutes
    options.triangulation.ignore_two_view_tracks = False  # many points of a wide rig are seen by two cameras only
    return options


def _reconstruct(work: Path, options: Any, count: int, progress: Progress) -> list[Any]:
    import pycolmap

    posed = 0

    def began() -> None:
        nonlocal posed
        posed = 2
        progress("poses", min(posed, count), count)

    def placed() -> None:
        nonlocal posed
        posed += 1
        progress("poses", min(posed, count), count)

    models = pycolmap.incremental_mapping(
        work / "database.db",
        work / "images",
        work,
        options,
        initial_image_pair_callback=began,
        next_image_callback=placed,
    )
    return list(models.values())


def _report(work: Path, model: Any) -> RigReport:
    """Report what a reconstruction has of each camera; `model` may be None."""
    import pycolmap

    database = pycolmap.Database.open(work / "database.db")
    matches: dict[int, list[int]] = {image.image_id: [] for image in database.read_all_images()}
    for pair, inliers in zip(*database.read_two_view_geometry_num_inliers(), strict=True):
        for number in pycolmap.pair_id_to_image_pair(pair):
            matches[number] += [int(inliers)] if inliers else []
    placed = {model.images[i].name: model.images[i] for i in model.reg_image_ids()} if model else {}
    cameras = []
    for image in sorted(database.read_all_images(), key=lambda image: image.image_id):
        seen, own = placed.get(image.name), matches[image.image_id]
        errors = [model.points3D[p.point3D_id].error for p in seen.get_observation_points2D()] if seen else []
        error = sum(errors) / len(errors) if errors else None
        features = database.num_keypoints_for_image(image.image_id)
        name = image.name.removesuffix(".png")
        cameras.append(RigCamera(name, bool(seen), features, sum(own), len(own), len(errors), error))
    database.close()
    points, error = (model.num_points3D(), model.compute_mean_reprojection_error()) if model else (0, 0.0)
    return RigReport(tuple(cameras), points, error)
