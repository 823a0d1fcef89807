"""The poster of a package: what viewers see until the first picture is there."""

from __future__ import annotations

from airgs_codec.media.image import encode_jpeg, resize, to_bytes, to_floats
from airgs_codec.package.tables import MAX_POSTER_BYTES
from airgs_codec.render import Camera
from airgs_codec.render.backend import Renderer
from airgs_codec.scene.camera import with_pixels
from airgs_codec.scene.sequence import GaussianSequence

SIDE = 640  # pixels of the longer side
QUALITIES = (90, 80, 70, 60, 50, 40, 30)  # of JPEG; a worse picture is made smaller instead


def draw_poster(sequence: GaussianSequence, frame: int, camera: Camera, renderer: Renderer) -> bytes:
    """Return a JPEG of what a camera sees of a frame, as good, and then as large, as MAX_POSTER_BYTES allow."""
    share = SIDE / max(camera.width, camera.height)
    shown = with_pixels(camera, round(share * camera.width), round(share * camera.height))
    picture = to_bytes(renderer.render(sequence.load([frame]).frames[0], shown).rgb)
    while True:
        for quality in QUALITIES:
            data = encode_jpeg(picture, quality)
            if len(data) <= MAX_POSTER_BYTES:
                return data
        height, width = (side * 3 // 4 for side in picture.shape[:2])
        picture = to_bytes(resize(to_floats(picture), width, height))
