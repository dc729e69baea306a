"""One's own pictures: any size, any depth, and messages for what is wrong."""

import itertools
from pathlib import Path

import numpy as np
import onnx
import OpenEXR
import pytest
import torch
from onnx import TensorProto, helper
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.errors import UserError
from multilight.model.cli import COMMANDS
from multilight.model.configs.stage2d import NetworkConfig
from multilight.model.device import chosen_device
from multilight.model.inference.depth import DepthModel, depth_from_inverse, depth_from_metres, guessed_depth
from multilight.model.inference.harmonize import WHOLE, _starts, harmonize, lights_of_views
from multilight.model.inference.pictures import read_depth, read_mask, read_picture, resized
from multilight.model.networks.checkpoint import save_network
from multilight.model.networks.compositing2d import Compositing2D

SMALL = {"body": "attention", "width": 16, "groups": 1, "blocks": 2, "heads": 2, "window": 4, "pooled": 2}


def network(head: str, *, random: bool = True) -> Compositing2D:
    torch.manual_seed(0)
    made = Compositing2D(NetworkConfig(head=head, **SMALL))
    if random:
        torch.nn.init.normal_(made.head.weight, std=0.02)
        torch.nn.init.normal_(made.head.get_parameter("bias"), std=0.1)
    return made.eval()


def pictures(height: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A smooth background, a pasted disc, its mask, and a slanted plane's depth."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    background = np.stack([0.3 + 0.2 * x / width, 0.4 + 0.1 * y / height, np.full_like(x, 0.35)], axis=-1)
    mask = (np.hypot(x - width / 2, y - height / 2) < min(height, width) / 5).astype(np.float32)
    composite = np.where(mask[..., None] > 0, np.array([0.8, 0.5, 0.2], np.float32), background)
    return composite, background, mask, guessed_depth(height, width)


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    composite, background, mask, depth = pictures(50, 70)
    made = {name: tmp_path / f"{name}.png" for name in ("composite", "background", "mask", "depth")}
    for name, picture in (("composite", composite), ("background", background), ("mask", mask)):
        Image.fromarray(np.rint(picture * 255).astype(np.uint8)).save(made[name])
    Image.fromarray((depth * 5000).astype(np.uint16)).save(made["depth"])
    save_network(tmp_path / "w.safetensors", network("gain"), NetworkConfig(head="gain", **SMALL), {})
    return made | {"weights": tmp_path / "w.safetensors", "out": tmp_path / "out" / "result.png"}


def run(files: dict[str, Path], *more: str, without: tuple[str, ...] = ()) -> int:
    words = [w for name, path in files.items() if name not in without for w in (f"--{name}", str(path))]
    return main(["harmonize", *words, *more], COMMANDS)


def guessing() -> Compositing2D:
    """A network of lights alone: what it makes of a picture follows from the lights that it guesses."""
    made = network("light", random=False)
    torch.nn.init.normal_(made.light.last.weight, std=0.5)
    return made


def test_lights_are_guessed_once_for_all_views(monkeypatch: pytest.MonkeyPatch) -> None:
    composite, background, mask, depth = pictures(48, 64)
    made, turned = guessing(), np.stack([np.eye(3)] * 3)
    others = [composite, np.where(mask[..., None] > 0, 0.2 * composite, background), composite]
    masks = [mask, mask, np.zeros_like(mask)]
    first, second, unseen = lights_of_views(made, others, [background] * 3, [depth] * 3, masks, turned)
    assert first is not None
    assert second is not None
    assert unseen is None
    assert torch.equal(first, second)
    alone = [harmonize(made, c, background, depth, mask=mask) for c in others[:2]]
    alike = [harmonize(made, c, background, depth, mask=mask, numbers=first) for c in others[:2]]
    assert max(np.abs(a - b).max() for a, b in zip(alone, alike, strict=True)) > 0.02
    own = lights_of_views(made, others[:1], [background], [depth], [mask], turned[:1])[0]
    np.testing.assert_allclose(
        harmonize(made, composite, background, depth, mask=mask, numbers=own), alone[0], atol=1e-5
    )
    monkeypatch.setattr(Compositing2D, "size", 40)
    large = harmonize(made, composite, background, depth, mask=mask, numbers=first)
    assert np.abs(large - alike[0]).mean() < 0.5 * np.abs(large - alone[0]).mean()
    views = (others, [background] * 3, [depth] * 3, masks, turned)
    assert lights_of_views(network("gain"), *views) == [None] * 3


def test_an_untrained_network_returns_the_composite() -> None:
    composite, background, mask, depth = pictures(33, 47)
    result = harmonize(network("gain", random=False), composite, background, depth, mask=mask)
    np.testing.assert_allclose(result, composite, atol=1e-5)


@pytest.mark.parametrize("head", ["light", "gain", "residual"])
def test_large_pictures_are_close_to_small_ones(head: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is done to a picture must not depend much on whether it was worked on whole."""
    composite, background, mask, depth = pictures(96, 128)
    made = network(head)
    whole = harmonize(made, composite, background, depth, mask=mask)
    monkeypatch.setattr("multilight.model.inference.harmonize.WHOLE", 64)
    monkeypatch.setattr(Compositing2D, "size", 64)
    monkeypatch.setattr("multilight.model.inference.harmonize.OVERLAP", 16)
    parts = harmonize(made, composite, background, depth, mask=mask)
    assert parts.shape == whole.shape
    changed = np.abs(whole - composite).mean()
    assert changed > 0.01
    assert np.abs(parts - whole).mean() < 0.35 * changed
    if head != "residual":
        edge = np.abs(np.diff(parts[48, :, 0])).max()
        assert edge > 0.5 * np.abs(np.diff(whole[48, :, 0])).max(), "outlines stay sharp"


def test_tiles_cover_the_picture_evenly() -> None:
    for length in (1, WHOLE, WHOLE + 1, 960, 961, 2048, 5000):
        starts = _starts(length)
        assert starts[0] == 0
        assert max(starts) + WHOLE >= length
        assert max(starts) + WHOLE == max(length, WHOLE)
        assert all(0 < b - a <= WHOLE - 60 for a, b in itertools.pairwise(starts))


def test_command_writes_a_picture_of_the_same_size(files: dict[str, Path]) -> None:
    assert run(files) == 0
    result = read_picture(files["out"])
    assert result.shape == (50, 70, 3)
    composite, background, mask = read_picture(files["composite"]), read_picture(files["background"]), files["mask"]
    depth = depth_from_metres(read_depth(files["depth"]))
    expected = harmonize(network("gain"), composite, background, depth, mask=read_mask(mask))
    np.testing.assert_allclose(result, expected, atol=0.51 / 255)


@pytest.mark.parametrize("depth", ["Z", "V", "ViewLayer.Depth.Z", "depth.Z", "R G B"])
def test_depth_of_exr(depth: str, tmp_path: Path) -> None:
    """What `multilight mix` writes, Blender's passes, and the grey pictures that some programs make of depth."""
    metres = np.linspace(0.5, 80, 42, dtype=np.float32).reshape(6, 7)
    written = metres.copy()
    written[0, 0] = 1e10
    channels = dict.fromkeys(depth.split(), written)
    if "." in depth:
        channels |= {f"ViewLayer.{name}": np.ones_like(metres) for name in ("Combined.R", "Normal.Z")}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(tmp_path / "depth.exr"))
    metres[0, 0] = 0.0
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.exr"), metres)


def test_exr_without_depth_is_told(tmp_path: Path) -> None:
    path = tmp_path / "colour.exr"
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: np.full((4, 4), v, np.float32) for v, name in enumerate("RGB")}).write(str(path))
    with pytest.raises(UserError, match=r"colour\.exr cannot be read: its channels are B, G, R; write the depth alone"):
        read_depth(path)
    content = path.read_bytes()
    path.write_bytes(content[:-20])
    with pytest.raises(UserError, match=r"colour\.exr cannot be read: it is truncated or damaged: B, G, R cannot"):
        read_depth(path)
    path.write_bytes(content[:100])
    with pytest.raises(UserError, match=r"colour\.exr cannot be read: it is no OpenEXR file that can be decoded"):
        read_depth(path)
    with pytest.raises(UserError, match=r"none\.exr does not exist"):
        read_depth(tmp_path / "none.exr")


def test_without_depth_level_ground_is_assumed(files: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(files, without=("depth",)) == 0
    assert "level ground" in capsys.readouterr().err


def test_wrong_sizes_and_files_are_told(files: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    Image.new("L", (70, 49), 255).save(files["mask"])
    assert run(files) == 1
    assert "mask.png is 70 x 49 pixels" in capsys.readouterr().err
    Image.new("L", (70, 50), 0).save(files["mask"])
    assert run(files) == 1
    assert "marks nothing" in capsys.readouterr().err
    files["mask"].write_bytes(b"no picture")
    assert run(files) == 1
    assert "not a picture" in capsys.readouterr().err
    files["mask"].unlink()
    assert run(files) == 1
    assert "mask.png does not exist" in capsys.readouterr().err


def test_truncated_pictures_are_told(files: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    content = files["background"].read_bytes()
    files["background"].write_bytes(content[: len(content) // 2])
    assert run(files) == 1
    assert "background.png cannot be read" in capsys.readouterr().err


def test_missing_weights_say_how_to_train(files: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    files["weights"].unlink()
    assert run(files) == 1
    assert "multilight train" in capsys.readouterr().err


def test_misaligned_pictures_are_noticed(files: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    Image.new("RGB", (70, 50), (250, 250, 250)).save(files["background"])
    assert run(files) == 0
    assert "are they aligned" in capsys.readouterr().err


def test_unknown_format_is_refused(files: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(files | {"out": files["out"].with_suffix(".xyz")}) == 1
    assert "no picture is written that ends in" in capsys.readouterr().err


def test_nan_is_told(tmp_path: Path) -> None:
    composite, background, mask, depth = pictures(20, 20)
    made = network("gain")
    with torch.no_grad():
        made.head.weight[0, 0, 0, 0] = float("nan")
    with pytest.raises(UserError, match="NaN"):
        harmonize(made, composite, background, depth, mask=mask)
    np.save(tmp_path / "depth.npy", np.full((4, 4), np.nan))
    with pytest.raises(UserError, match="holds NaN on 16 pixels"):
        read_depth(tmp_path / "depth.npy")


def test_memory_that_runs_out_is_told() -> None:
    composite, background, mask, depth = pictures(20, 20)
    made = network("gain")

    def full(*_: object) -> None:
        torch.empty(2**50)  # a petabyte and more: the allocator's own error

    made.backbone.register_forward_pre_hook(full)
    with pytest.raises(UserError, match="20 x 20 pixels do not fit"):
        harmonize(made, composite, background, depth, mask=mask)


def test_unknown_device_is_told() -> None:
    with pytest.raises(UserError, match="device 'tpu9'"):
        chosen_device("tpu9")


def test_pictures_are_turned_as_the_camera_noted(tmp_path: Path) -> None:
    image = Image.new("RGB", (8, 4))
    image.putpixel((0, 0), (255, 0, 0))
    exif = Image.Exif()
    exif[0x0112] = 6  # turn clockwise by a quarter to see it upright
    image.save(tmp_path / "a.png", exif=exif)
    picture = read_picture(tmp_path / "a.png")
    assert picture.shape == (8, 4, 3)
    assert picture[0, 3, 0] == 1.0


def test_depths_as_networks_see_them() -> None:
    z = np.array([[1.0, 2.0], [4.0, 0.0]], np.float32)
    np.testing.assert_allclose(depth_from_metres(z), [[0.25, 0.5], [1.0, 1.0]])
    plane = guessed_depth(200, 3)
    assert (np.diff(plane[:, 0]) < 0).all(), "nearer towards the bottom"
    np.testing.assert_allclose(np.diff(1 / plane[:, 0]), 1 / 200, rtol=1e-3)


def test_inverse_depth_of_a_plane_is_found_up_to_scale() -> None:
    z = guessed_depth(400, 4) * 3.0
    found = depth_from_inverse(17.0 / z)
    np.testing.assert_allclose(found, z / np.percentile(z, 99), rtol=0.02)
    assert depth_from_inverse(np.array([[1.0, 0.0]], np.float32)).max() == 1.0


def depth_onnx(path: Path, *, channels: int = 3, fixed: tuple[int, int] | None = None, rank: int = 3) -> Path:
    """A model with Depth Anything V2's layout whose inverse depth is the picture's red, before normalization."""
    height, width = fixed or ("height", "width")
    weight = np.zeros((1, channels, 1, 1), np.float32)
    weight[0, 0] = 0.229
    nodes = [helper.make_node("Conv", ["image", "w", "b"], ["map"])]
    nodes.append(helper.make_node("Squeeze", ["map", "axes"], ["depth"]) if rank == 3 else
                 helper.make_node("Identity", ["map"], ["depth"]))  # fmt: skip
    shape = [1, height, width] if rank == 3 else [1, 1, height, width]
    graph = helper.make_graph(
        nodes,
        "depth",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, channels, height, width])],
        [helper.make_tensor_value_info("depth", TensorProto.FLOAT, shape)],
        [
            onnx.numpy_helper.from_array(weight, "w"),
            onnx.numpy_helper.from_array(np.array([0.485], np.float32), "b"),
            onnx.numpy_helper.from_array(np.array([1], np.int64), "axes"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))
    return path


@pytest.mark.parametrize(("fixed", "rank"), [(None, 3), ((70, 98), 4)])
def test_onnx_depth_model(tmp_path: Path, fixed: tuple[int, int] | None, rank: int) -> None:
    """Its "inverse depth" is the picture's red, so normalization, channel order and resizing all show."""
    y = np.linspace(0.25, 1.0, 60, dtype=np.float32)[:, None]
    picture = np.stack([np.broadcast_to(y, (60, 90)), np.full((60, 90), 0.9), np.full((60, 90), 0.1)], axis=-1)
    depth = DepthModel.load(depth_onnx(tmp_path / "d.onnx", fixed=fixed, rank=rank)).estimate(picture.astype("f4"))
    assert depth.shape == (60, 90)
    np.testing.assert_allclose(depth[5:-5, 5:-5], (0.26 / y)[5:-5].repeat(80, axis=1), rtol=0.05)


def test_onnx_model_in_the_command(files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = depth_onnx(tmp_path / "d.onnx")
    assert run(files, "--depth-model", str(model), without=("depth",)) == 0
    assert "level ground" not in capsys.readouterr().err
    assert run(files, "--depth-model", str(model)) == 1
    assert "not both" in capsys.readouterr().err


def test_other_onnx_models_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="1 x 3 x H x W"):
        DepthModel.load(depth_onnx(tmp_path / "two.onnx", channels=2))
    (tmp_path / "bad.onnx").write_bytes(b"nothing")
    with pytest.raises(UserError, match="cannot be opened"):
        DepthModel.load(tmp_path / "bad.onnx")
    with pytest.raises(UserError, match="does not exist"):
        DepthModel.load(tmp_path / "missing.onnx")


def test_resizing_keeps_flat_pictures_and_means() -> None:
    np.testing.assert_allclose(resized(np.full((10, 12), 0.3, np.float32), (5, 20)), 0.3, atol=1e-6)
    ramp = np.linspace(0, 1, 64, dtype=np.float32)[None, :, None].repeat(8, 0).repeat(3, 2)
    np.testing.assert_allclose(resized(ramp, (8, 16)).mean(), 0.5, atol=1e-3)
