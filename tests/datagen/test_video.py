"""The film of a scene, and videos read back."""

import re
import subprocess
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.errors import UserError
from multilight.datagen.files.video import CODECS, write_video
from multilight.datagen.report import silent
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData
from multilight.datagen.tuples import compose
from multilight.datagen.tuples.condition_files import metered
from multilight.datagen.tuples.film import film
from multilight.datagen.tuples.sheet import two_conditions
from multilight.lights.display.tonemap import to_display
from multilight.lights.spec import LightingCondition


def decoded(path: Path, size: tuple[int, int]) -> tuple[str, np.ndarray]:
    """Decode a video: what ffmpeg says of it, and its frames (N, H, W, 3) in [0, 1]."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(command, capture_output=True, check=True)
    return done.stderr.decode(), np.frombuffer(done.stdout, np.uint8).reshape(-1, size[1], size[0], 3) / 255.0


def test_video_can_be_read_back(tmp_path: Path) -> None:
    colours = np.linspace(0.1, 0.9, 12)[:, None] * [1.0, 0.5, 0.2]
    frames = [np.full((48, 64, 3), np.rint(255 * colour), np.uint8) for colour in colours]
    assert write_video(tmp_path / "v.mp4", frames) == 0.5
    told, read = decoded(tmp_path / "v.mp4", (64, 48))
    assert "24 fps" in told
    assert len(read) == 12
    np.testing.assert_allclose(read.mean(axis=(1, 2)), colours, atol=0.04)
    write_video(tmp_path / "v.webp", frames)
    with Image.open(tmp_path / "v.webp") as image:
        assert (image.size, image.info["loop"]) == ((64, 48), 0)
        assert image.n_frames == 12  # type: ignore[attr-defined]
        image.seek(11)
        assert np.asarray(image.convert("RGB")).mean(axis=(0, 1)) / 255 == pytest.approx(colours[11], abs=0.04)
    for suffix in CODECS:
        with pytest.raises(UserError, match=r"cannot be written: .*No such file"):
            write_video(tmp_path / "no" / f"v{suffix}", iter(frames * 200))


def test_a_film_shows_lights_then_composite_against_target(
    spheres_dataset: Path, sphere_view: tuple[SceneRecord, ViewData]
) -> None:
    record, view = sphere_view
    frames = list(film(open_dataset(spheres_dataset), record, name := record.scene.insertable[0], silent))
    assert all(frame.shape == (480, 640, 3) for frame in frames)
    seen = np.stack([frame[:400:8, ::8] for frame in frames]).astype(int)  # above the captions

    def differences(radiance: np.ndarray) -> np.ndarray:
        picture = Image.fromarray(to_display(radiance)).resize((640, 480), Image.Resampling.LANCZOS)
        return np.abs(seen - np.asarray(picture)[:400:8, ::8]).max(axis=(1, 3))

    light = record.rig.names[0]
    alone = metered(LightingCondition(name=light, gains={light: (1.0,) * 3}), view)
    for lit in (record.condition("all"), alone):
        assert (differences(compose.target(view, lit)).max(axis=1) == 0).sum() > 10  # frames that hold it
    _, base = two_conditions(record, 0)
    right = differences(compose.target(view, base)) == 0
    lefts = [differences(compose.composite(view, name, insert=insert, base=base)) == 0 for insert in record.conditions]
    swept = [max(left[frame, :35].all() for left in lefts) and right[frame, 45:].all() for frame in range(len(frames))]
    assert 3 <= sum(swept) <= 12
    steps = np.abs(np.diff(np.concatenate([seen, seen[:1]]), axis=0)).mean(axis=(1, 2, 3))
    assert steps.max() < 12  # nothing jumps, the way back to the start least of all


def test_the_command_writes_a_film(spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "film.mp4"
    assert main(["video", str(spheres_dataset), "--scene", "1", "--out", str(out)]) == 0
    assert re.fullmatch(rf"{re.escape(str(out))}: \d+ s, 3 views, \d+ lights, .*B\n", capsys.readouterr().out)
    assert out.stat().st_size > 10_000
    for words, told in {
        ("--scene", "9"): "--scene 9 is not in",
        ("--object", "sphere"): "did you mean 'sphere_",
        ("--out", str(tmp_path / "film.gif")): "the suffix must be .mp4 or .webp",
    }.items():
        assert main(["video", str(spheres_dataset), "--out", str(out), *words]) == 1
        assert told in capsys.readouterr().err
