"""The faces of the package that tests hold on to: where a name moves, this file follows and no test does.

Only kernels (range coder, escapes, grid, rasteriser, MP4, H.264) and rules that no face shows are imported from where
they are.
"""

# Errors of one line
from airgs_codec.errors import (
    AirgsError, CodecError, ConfigError, FormatError, SceneError, TrainingError, TransportError, WorkError,
)  # fmt: skip

# Reading and writing: splats, cameras, pictures, places
from airgs_codec.scene.gaussians import (
    Gaussians, SH_C0, SH_REST, conjugate, from_rotation_vector, mix_rows, morton_decode, morton_encode,
    multiply, sigmoid, to_matrices, to_rotation_vector,
)  # fmt: skip
from airgs_codec.scene.camera import (
    Camera, OPENGL_TO_OPENCV, dome_views, look_at, orbit_views, placed, training_views, with_pixels,
)  # fmt: skip
from airgs_codec.scene.cameras import find_cameras, read_cameras, read_posed
from airgs_codec.scene.beside import MEASURES, USAGE_NAME, Usage, load_usage, read_settings, save_usage
from airgs_codec.scene.frames import HeldFrames, Repaired, repair, turn_least
from airgs_codec.scene.sequence import GaussianSequence, GrowingFolder, open_sequence
from airgs_codec.scene.formats.ply import read_ply, read_points, write_ply
from airgs_codec.scene.formats.table import (
    COMPRESSED, FRAMES, GLTF, INRIA, SOG, SPLAT, SPZ, format_of, read_frame, read_frame_header,
)  # fmt: skip
from airgs_codec.media.image import box_mean, read_picture, resize, to_bytes, write_png
from airgs_codec.media.movie import VideoReader, decode_sound, encode_sound, write_movie
from airgs_codec.places.place import Bucket, Folder, Memory, bucket_at, place_at
from airgs_codec.places.results import Store, digest as content_digest, load, open_store, pack, seal, unpack, unseal

# Deciding and encoding
from airgs_codec.analysis.rows import Restored, first_look, restore_rows
from airgs_codec.analysis.grouping import closed_groups, plan_groups
from airgs_codec.analysis.viewpoints import find_viewpoints
from airgs_codec.analysis.region import region_around
from airgs_codec.encoder.settings import INTER, INTRA, EncodeSettings, LevelSettings, as_in_paper, as_fast
from airgs_codec.encoder.survey import Frames, Survey
from airgs_codec.encoder.layout import GroupLayout, lay_out
from airgs_codec.encoder.views import choose_views
from airgs_codec.encoder.target import DELTA_E, Goal, PSNR, SIZE
from airgs_codec.encoder.decide import decide
from airgs_codec.encoder.plan import Choice, Plan
from airgs_codec.encoder.group import encode_group
from airgs_codec.encoder.live import follow
from airgs_codec.encoder.publish import EncodeReport, encode
from airgs_codec.coding.atlas import from_codes, to_codes
from airgs_codec.coding.channels import pack_matrix, unpack_matrix
from airgs_codec.coding.motion import StepSettings, get_step, with_step

# Packages: tables, paths, the MPD, validation
from airgs_codec.package.layout import (
    FileKind, INIT_NAME, JSON_NAME, KEYFRAME, MPD_NAME, POSTER_NAME, SOUND_INIT_NAME, DELTA, file_kind, group_path,
    keyframe_media_path, keyframe_sidecar_path, locate, page_path, sound_path, delta_media_path,
)  # fmt: skip
from airgs_codec.package.tables import (
    Atlas, FileEntry, Grid, Group, KeyframeSteps, LeftOut, MAX_PLACES, NO_FILE, PAGE, Place, Region, STATIC, Segment,
    Sound, DeltaSteps, World, digest, file_entry,
)  # fmt: skip
from airgs_codec.package.manifest import (
    GroupIndex, Groups, Manifest, build_index, count_groups, extend_index, on_ladder, quality_of,
)  # fmt: skip
from airgs_codec.package.mpd import LiveClock, Streams, check_mpd, largest_picture, still_files, write_mpd
from airgs_codec.package.package import (
    Package, REPR_DIGEST, check_repr_digest, find_faults, open_files, open_manifest, open_package, repr_digest,
    root_of, write_file,
)  # fmt: skip
from airgs_codec.package.parse import (
    MAX_TABLE_BYTES, check_base, check_group, check_root, pack_group, pack_json, parse_group, parse_root, read_region,
)  # fmt: skip
from airgs_codec.package.publish import GrowingPackage, staged_package, write_root, write_tables
from airgs_codec.package.region import (
    FORGIVEN_DEGREES, FORGIVEN_SHARE, MEASURING, before_background, draw_views, levelled, opening_view, place_view,
    read_world, up_of, upright, world_from, world_words,
)  # fmt: skip
from airgs_codec.package.publish import set_view
from airgs_codec.inspect.validate import exceeded, validate, validate_files
from airgs_codec.inspect.errors import measure_errors
from airgs_codec.inspect.stiff import stiff_cases
from airgs_codec.inspect.summary import describe_left_out, format_ladder, format_summary, plot_ladder, summarise
from airgs_codec.inspect.compare import (
    LABEL, comparable, compare_streams, compare_two, compared_views, comparison_json, difference_gain, format_two,
    left_out, open_side, rung_streams, shared_views, side_by_side,
)  # fmt: skip

# Decoding
from airgs_codec.decoder.decode import (
    decode, decode_canonical, decode_frames, decode_pictures, decode_segment,
)  # fmt: skip

# Rendering and measuring pictures
from airgs_codec.render import render
from airgs_codec.render.cpu import RasterInputs, Redraw, one_thread
from airgs_codec.render.backend import CPU
from airgs_codec.media.metrics import Difference, PSNR_CAP, Picture, Quality, delta_e, delta_e_metric, mse, pool, psnr

# Training
from airgs_codec.trainer import train
from airgs_codec.trainer.settings import Temporal, TrainSettings, preset
from airgs_codec.trainer.frames import Capture
from airgs_codec.trainer.data.multiview import (
    MultiviewScene, Points, Shot, with_held_out, with_near,
)  # fmt: skip
from airgs_codec.trainer.data.pictures import (
    PICTURE_BYTES, ScenePictures as Pictures, TARGET_BYTES, TargetPicture as Target, View,
)  # fmt: skip
from airgs_codec.trainer.data.readers import is_multiview, open_scene
from airgs_codec.trainer.data.pictures import FrameViews
from airgs_codec.trainer.fit.trainer import Trainer, fit_first
from airgs_codec.trainer.fit.losses import GAUSSIAN_FIELDS as ATTRIBUTES, InMotion, Parameters, from_gaussians
from airgs_codec.trainer.fit.optimise import Adam
from airgs_codec.trainer.fit.points import from_points, scene_extent
from airgs_codec.trainer.pipeline import content_of, open_run, read_contents, rested, train_frames, train_in_jobs
from airgs_codec.trainer.track import tracked
from airgs_codec.trainer.record import FrameRecord, Record, TrainedFrame, MODEL_VERSION, read_model

# Playing
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.trace import Link, Trace
from airgs_codec.play.offers import Batch, NO_KEYFRAMES as NONE, Offers
from airgs_codec.play.ladder import Decision
from airgs_codec.play.downloader import (
    Arrival, Arrived, BatchKind, Cut, Event, GiveUp, Lost, Replaced, Request, Displayed as Shown, SimulatedDownloader,
)  # fmt: skip
from airgs_codec.play.http import HttpDownloader, HttpSettings, RemoteTables
from airgs_codec.play.player import run
from airgs_codec.play.report import answer, beaten_words, find_waits, format_metrics, write_report
from airgs_codec.play.film import sound_of, walk, walk_through
from airgs_codec.play.study import (
    Study, StudySettings, format_study, interval, is_feasible, offsets_of, run_study, study_answer, study_record,
)  # fmt: skip
from airgs_codec.play.session import SessionLog, play, session_bound, simulate
from airgs_codec.play.policies import (
    ADAPTIVE, Coming, Download, POLICY_NAMES as NAMES, PlayerState, Policy, estimate_throughput, make_policy,
)  # fmt: skip
from airgs_codec.play.bound import Slot, solve_horizon

# Serving
from airgs_codec.serve.app import (
    Packages, check_certificate, listen, make_app, media_type, serve,
)  # fmt: skip
from airgs_codec.serve.pages import PAGE_TYPES, content_policy, describe, is_built, list_page
from airgs_codec.serve.export import export_page
from airgs_codec.serve.scenes import Scenes

# Work in jobs
from airgs_codec.jobs.executors import DaskCluster, Processes
from airgs_codec.jobs.work import Work

# Commands
from airgs_codec.cli.decode import main as airgs_decode
from airgs_codec.cli.encode import main as airgs_encode
from airgs_codec.cli.manifest import main as airgs_manifest
from airgs_codec.cli.play import main as airgs_play
from airgs_codec.cli.serve import main as airgs_serve
from airgs_codec.cli.train import main as airgs_train
from airgs_codec.cli.terminal import Bar
from airgs_codec.cli.train import match_cameras

join_rows = Gaussians.join
