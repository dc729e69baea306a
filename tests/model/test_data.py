"""Training data: lighting made on the fly, the same for any number of workers, and true to the stored layers."""

import itertools
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, DistributedSampler

import multilight
from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.storage.address import find_place
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.storage.packed import PackedView
from multilight.datagen.tuples import compose
from multilight.datagen.tuples.condition_files import save_condition
from multilight.lights.display.tonemap import tone_curve
from multilight.lights.spec import (
    AreaLight,
    EmissiveLight,
    EnvironmentLight,
    Light,
    LightRig,
    PointLight,
    SpotLight,
    SunLight,
)
from multilight.model.data import MultiLightDataset, MultiLightStream, SampleSettings
from multilight.model.data.augment import PLAIN, draw_camera, respond
from multilight.model.data.faults import Placement, misplaced_tuple
from multilight.model.data.lighting import draw_gains, tints
from multilight.model.data.lights import KINDS, SceneLights, read_lights
from multilight.model.data.mixing import mix_tuple
from multilight.model.data.plan import generator
from multilight.scenes.arrays import Float32
from multilight.scenes.colour import luminance, srgb_encode
from multilight.scenes.poses import matrix4, translation
from multilight.scenes.spec import Sphere
from tests import ROOT

pytestmark = pytest.mark.usefixtures("own_cache")
DAYLIGHTS = np.full(5, 6504.0, np.float32)
SMALL: dict[str, Any] = {"split": None, "visible": 5.0, "size": 32}


def opened(root: Path | str, **settings: Any) -> MultiLightDataset:
    return MultiLightDataset(root, SampleSettings(**(SMALL | settings)))


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return one["meta"] == other["meta"] and all(torch.equal(one[k], other[k]) for k in one if k != "meta")


@pytest.mark.parametrize("views", [1, 3])
def test_shapes_and_ranges(packed: Path, views: int) -> None:
    group = () if views == 1 else (views,)
    for sample in DataLoader(opened(packed, views=views, length=20), batch_size=None):
        for name, shape in {
            "composite": (3, 32, 32), "background": (3, 32, 32), "target": (3, 32, 32), "effect": (3, 32, 32),
            "depth": (1, 32, 32), "z_depth": (1, 32, 32), "mask": (1, 32, 32), "glow": (1, 32, 32),
            "K": (3, 3), "c2w": (4, 4),
            "insert_gains": (8, 3), "base_gains": (8, 3), "light_position": (8, 3), "light_direction": (8, 3),
            "light_towards": (8, 3), "light_fraction": (8,),
            "light_amount": (8, 3), "light_size": (8,),
        }.items():  # fmt: skip
            assert sample[name].shape == (*group, *shape)
            assert sample[name].dtype == torch.float32
            assert torch.isfinite(sample[name]).all()
        assert (sample["light_kind"] > 0).equal(sample["light_mask"])
        assert sample["light_mask"].shape == (*group, 8)
        for name in ("composite", "background", "target", "depth", "mask"):
            assert 0.0 <= sample[name].min() <= sample[name].max() <= 1.0
        assert torch.equal(sample["effect"], sample["target"] - sample["background"])
        assert sample["depth"].max() == 1.0
        outside = sample["mask"].expand_as(sample["target"]) == 0
        assert torch.equal(sample["composite"][outside], sample["background"][outside])
        meta = sample["meta"]
        assert {type(meta[k]) for k in ("scene", "view", "emissive")} == {int}
        assert {type(meta[k]) for k in ("object", "kind")} == {str}


def test_tuples_are_those_of_compose(spheres_dataset: Path, packed: Path) -> None:
    """Stored lighting, nothing augmented: `datagen.tuples.compose` and the tone curve, in float64, about the centre."""
    data = opened(packed, size=48, lighting="stored", augment=False, length=40)
    source = open_dataset(spheres_dataset)
    for index in range(len(data)):
        sample, draw = data[index], data.plan.draw(0, index)
        record, name = source.scene(draw.place.scene), draw.place.object
        view = source.view(record, draw.views[0])
        assert draw.conditions is not None
        insert, base = (record.conditions[number] for number in draw.conditions)
        wanted = {
            "target": compose.target(view, base),
            "background": compose.background(view, name, base),
            "composite": compose.composite(view, name, insert=insert, base=base),
        }
        for what, linear in wanted.items():
            shown = srgb_encode(tone_curve(linear))[:, 8:56].transpose(2, 0, 1)
            np.testing.assert_allclose(sample[what].numpy(), shown, atol=5e-5, err_msg=what)
        np.testing.assert_array_equal(sample["mask"][0], view.coverage[name][:, 8:56])
        np.testing.assert_array_equal(sample["z_depth"][0], view.geometry.z_depth[:, 8:56])
        camera = record.views[draw.views[0]]
        np.testing.assert_allclose(sample["K"], np.array(camera.K) - [[0, 0, 8], [0, 0, 0], [0, 0, 0]], rtol=1e-6)


def test_a_painted_object_is_lit_alike_in_another_colour(packed: Path) -> None:
    data, paint = opened(packed, length=6), np.array([0.5, 1.0, 1.7], np.float32)
    for index in range(len(data)):
        draw = data.plan.draw(0, index)
        view, name = data.source.view(draw.place.scene, draw.views[0]), draw.place.object
        insert, base = view.conditions[0], view.conditions[1]
        found = mix_tuple(
            view, name, insert=insert, base=base, camera=PLAIN, own=np.zeros(len(insert), bool), paint=paint
        )
        alpha = view.object_coverage(name)[..., None].astype(np.float32)

        def mixed(variant: str, gains: Float32, view: PackedView = view) -> Float32:
            return np.asarray(np.einsum("lhwc,lc->hwc", view.variant(variant).astype(np.float32), gains))

        behind, own = mixed(f"without_{name}", base), f"foreground_{name}"
        wanted = {
            "composite": behind * (1 - alpha) + mixed(own, insert) * paint,
            "target": mixed("all", base) + mixed(own, base) * (paint - 1),
            "background": behind,
        }
        for what, linear in wanted.items():
            shown = srgb_encode(tone_curve(linear.clip(min=0))).transpose(2, 0, 1)
            np.testing.assert_allclose(getattr(found, what).numpy(), shown, atol=2e-4, err_msg=what)


def test_glow_is_the_fraction_of_the_objects_own_light(packed: Path) -> None:
    data = opened(packed, length=6)
    for index in range(len(data)):
        draw = data.plan.draw(0, index)
        view, name = data.source.view(draw.place.scene, draw.views[0]), draw.place.object
        insert, base = view.conditions[0], view.conditions[1]
        layers = view.variant(f"foreground_{name}").astype(np.float32)
        own = np.arange(len(insert)) == np.einsum("lhwc,lc->l", layers, insert).argmax()
        lit: Any = {"insert": insert, "base": base, "camera": PLAIN, "own": own}
        shares = [np.einsum("lhwc,lc->hw", layers, gains) for gains in (insert * own[:, None], insert)]
        wanted = view.object_coverage(name) * shares[0] / np.maximum(shares[1], 1e-6)
        assert wanted.max() > 0.2
        for found in (mix_tuple(view, name, **lit), misplaced_tuple(view, name, Placement(), **lit)):
            np.testing.assert_allclose(found.glow[0], wanted, atol=2e-3)
        assert mix_tuple(view, name, **(lit | {"own": np.zeros_like(own)})).glow.max() == 0.0


def test_a_sample_depends_on_seed_epoch_and_index_only(packed: Path) -> None:
    data, again = opened(packed, views=2, length=30), opened(packed, views=2, length=60)
    assert all(same(data[i], again[i]) for i in reversed(range(8)))
    first = data[3]
    data.set_epoch(1)
    assert not torch.equal(data[3]["target"], first["target"])
    data.set_epoch(0)
    assert same(data[3], first)
    assert not torch.equal(opened(packed, views=2, seed=1)[3]["target"], first["target"])


def test_workers_change_nothing_and_learn_of_epochs(packed: Path) -> None:
    data = opened(packed, length=6)
    loader = DataLoader(data, batch_size=None, num_workers=2, persistent_workers=True, multiprocessing_context="spawn")
    for epoch in (0, 1):
        data.set_epoch(epoch)
        loaded = list(loader)
        assert len(loaded) == 6
        assert all(same(sample, data[i]) for i, sample in enumerate(loaded))


def test_distributed_sampler_shares_out(packed: Path) -> None:
    data = opened(packed, length=20)
    seen: list[list[int]] = [list(DistributedSampler(data, num_replicas=2, rank=rank)) for rank in (0, 1)]
    assert sorted(seen[0] + seen[1]) == list(range(20))
    batch = next(iter(DataLoader(data, batch_size=4, sampler=DistributedSampler(data, num_replicas=2, rank=1))))
    assert batch["target"].shape == (4, 3, 32, 32)
    assert batch["meta"]["scene"].shape == (4,)
    assert torch.equal(batch["target"][0], data[seen[1][0]]["target"])


def test_no_stored_tuple_comes_twice(packed: Path) -> None:
    places, pairs = len(opened(packed).plan.places), 12 * 11
    data = opened(packed, lighting="stored", length=places * pairs)
    draws = [data.plan.draw(2, index) for index in range(len(data))]
    assert len({(d.place, d.views, d.conditions) for d in draws}) == len(data)
    assert {d.conditions for d in draws} == set(itertools.permutations(range(12), 2))
    assert [len({d.place for d in draws[i : i + places]}) for i in range(0, len(data), places)] == [places] * pairs
    with pytest.raises(UserError, match=f"{places * pairs} different tuples"):
        opened(packed, lighting="stored", length=places * pairs + 1)
    assert len(opened(packed, lighting="stored", length=places * pairs + 1, repeat=True)) == places * pairs + 1


def test_no_drawn_tuple_comes_twice(packed: Path) -> None:
    data = opened(packed, augment=False, length=150)
    shown = {(s["target"].numpy().tobytes(), s["composite"].numpy().tobytes()) for s in (data[i] for i in range(150))}
    assert len(shown) == 150


def test_hardly_visible_objects_are_passed_over(spheres_dataset: Path, packed: Path) -> None:
    source, least = open_dataset(spheres_dataset), 40.0
    wanted = {
        (record.index, number, name)
        for record in source.scenes()
        for number in range(len(record.views))
        for name, alpha in source.view(record, number).coverage.items()
        if alpha.sum(dtype=np.float64) >= least
    }
    for root in (spheres_dataset, packed):
        assert {(p.scene, p.seen[0], p.object) for p in opened(root, visible=least).plan.places} == wanted
    assert 0 < len(wanted) < 18
    with pytest.raises(UserError, match="on 4000 pixels"):
        opened(packed, visible=4000.0)


def test_filters_choose_the_scenes(packed: Path) -> None:
    assert {p.scene for p in opened(packed, where="index = 1").plan.places} == {1}
    assert {p.scene for p in opened(packed, split="train").plan.places} == {0, 1}
    with pytest.raises(UserError, match="colour"):
        opened(packed, where="colour = 'red'")
    with pytest.raises(UserError, match="no scene"):
        opened(packed, where="index > 7 OR index < 0")


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"views": 0}, "views 0 must be a whole number from 1 up"),
        ({"size": 32.5}, "size 32.5 must be a whole number"),
        ({"visible": float("nan")}, "visible nan must be a number of pixels"),
        ({"split": "trian"}, r"split 'trian': did you mean 'train'\? it must be one of 'train', 'val', 'test'"),
        ({"lighting": "store"}, r"lighting 'store': did you mean 'stored'\? it must be one of 'random', 'wild'"),
        ({"size": 2000}, "size 2000 is too large: the pictures' shorter side has 48 pixels.* ask for 48"),
    ],
)  # fmt: skip
def test_wrong_settings_are_told(packed: Path, settings: dict[str, Any], expected: str) -> None:
    with pytest.raises(UserError, match=expected):
        opened(packed, **settings)


def test_enlarging_is_told(packed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert opened(packed, size=64)[0]["target"].shape == (3, 64, 64)
    assert capsys.readouterr().err == "size 64: the pictures' shorter side has 48 pixels, they are enlarged\n"
    opened(packed, size=48)
    assert capsys.readouterr().err == ""


def test_cropped_and_mirrored_views_show_the_scene_in_its_place(spheres_dataset: Path, packed: Path) -> None:
    """Depth, lifted to the world by K and c2w, lies on the scene's spheres and floor, or on their mirror image."""
    data, source, facing = opened(packed, views=2, size=48, length=16), open_dataset(spheres_dataset), set()
    for index in range(16):
        sample = data[index]
        record = source.scene(sample["meta"]["scene"])
        mirrored = bool(np.isclose(sample["c2w"][0, 0, 3], -record.views[sample["meta"]["view"]].c2w[0][3], atol=1e-5))
        facing.add(mirrored)
        for number in (0, 1):
            view = {name: sample[name][number].double().numpy() for name in ("K", "c2w", "z_depth")}
            np.testing.assert_allclose(np.linalg.det(view["c2w"][:3, :3]), 1.0, rtol=1e-5)
            points = _points(view) * np.array([[-1.0 if mirrored else 1.0], [1.0], [1.0]])
            gaps = [np.abs(points[2])]
            for body in record.scene.bodies:
                if isinstance(body.geometry, Sphere):
                    centre = np.array(body.world_from_body)[:3, 3:]
                    gaps.append(np.abs(np.linalg.norm(points - centre, axis=0) - body.geometry.radius))
            # Depth is that of the nearest stored pixel: outlines and slanted floors are a little off.
            assert np.mean(np.min(gaps, axis=0) < 0.03) > 0.95
    assert facing == {True, False}


def _points(view: dict[str, np.ndarray]) -> np.ndarray:
    """Lift every pixel's centre by its z_depth to the world, (3, N); OpenGL axes."""
    v, u = np.mgrid[:48, :48] + 0.5
    rays = np.linalg.inv(view["K"]) @ np.stack([u.ravel(), v.ravel(), np.ones(48 * 48)])
    depth = view["z_depth"].ravel()
    points = rays[:, depth > 0] * depth[depth > 0] * np.array([[1.0], [-1.0], [-1.0]])
    return view["c2w"][:3, :3] @ points + view["c2w"][:3, 3:]


def stored_lights(root: Path, sample: dict[str, Any]) -> list[Light]:
    """Return a sample's lights as the scene's record has them, in the order of the layers."""
    return sorted(open_dataset(root).scene(sample["meta"]["scene"]).rig.lights, key=lambda light: light.name)


def test_pictures_are_the_gains_mix(spheres_dataset: Path, packed: Path) -> None:
    data, source = opened(packed, size=48, augment=False, length=12), open_dataset(spheres_dataset)
    for index in range(12):
        sample, name = data[index], data.plan.draw(0, index).place.object
        view = source.view(source.scene(sample["meta"]["scene"]), sample["meta"]["view"])
        base, insert = (sample[f"{which}_gains"].numpy() for which in ("base", "insert"))
        count = len(view.lights)
        assert not np.concatenate([base[count:], insert[count:]]).any()
        assert sample["light_mask"].tolist() == [True] * count + [False] * (8 - count)
        target = np.einsum("lhwc,lc->hwc", view.variants["all"], base[:count])
        behind = np.einsum("lhwc,lc->hwc", view.variants[f"without_{name}"], base[:count])
        pasted = np.einsum("lhwc,lc->hwc", view.variants[f"foreground_{name}"], insert[:count])
        composite = pasted + (1 - view.coverage[name][..., None]) * behind
        for what, linear in (("target", target), ("background", behind), ("composite", composite)):
            shown = srgb_encode(tone_curve(linear))[:, 8:56].transpose(2, 0, 1)
            np.testing.assert_allclose(sample[what].numpy(), shown, atol=5e-5, err_msg=what)


def test_saved_conditions_light_the_samples(spheres_dataset: Path, packed: Path, tmp_path: Path) -> None:
    """As `Scene.tuple` does by the same file, whatever lighting would else be drawn."""
    scene, files = multilight.open(spheres_dataset)[0], (tmp_path / "a.json", tmp_path / "b.json")
    insert, base = (scene.condition(seed) for seed in (3, 4))
    for file, condition in zip(files, (insert, base), strict=True):
        save_condition(condition, file)
    wanted: dict[str, Any] = {"size": 48, "augment": False, "where": "index = 0"}
    for lighting in ("random", "stored"):
        for one, other in (files, (insert, base)):
            data = opened(packed, **wanted, lighting=lighting, insert_condition=one, condition=other)
            sample, draw = data[0], data.plan.draw(0, 0)
            true = scene.tuple(sample["meta"]["view"], draw.place.object, condition=base, insert_condition=insert)
            for what in ("composite", "background", "target"):
                shown = srgb_encode(tone_curve(getattr(true, what)))[:, 8:56].transpose(2, 0, 1)
                np.testing.assert_allclose(sample[what].numpy(), shown, atol=5e-5, err_msg=what)
    drawn, half = opened(packed, **wanted)[0], opened(packed, **wanted, insert_condition=files[0])[0]
    assert torch.equal(drawn["target"], half["target"])
    assert not torch.equal(drawn["composite"], half["composite"])
    right = opened(packed, **wanted, insert_condition=files[0], right=1.0)[0]  # what is asked for is not made right
    assert not torch.equal(right["insert_gains"], right["base_gains"])


def test_saved_conditions_of_other_scenes_are_refused(packed: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere.json"
    elsewhere.write_text('{"name": "night", "gains": {"chandelier": 1}}')
    with pytest.raises(
        UserError, match=r"'night': scene \d has no light 'chandelier' but .*choose the scenes .* by where"
    ):
        opened(packed, condition=elsewhere)
    elsewhere.write_text('{"name": "night", "gains": {"key": -1}}')
    with pytest.raises(UserError, match=r"elsewhere.json is not a lighting condition: gains.key.0 = -1; allowed"):
        opened(packed, insert_condition=elsewhere)
    with pytest.raises(UserError, match=r"condition .*missing.json: it cannot be read \(No such file"):
        opened(packed, condition=tmp_path / "missing.json")


def test_gains_hold_the_cameras_exposure_and_white_balance(packed: Path) -> None:
    plain, varied = opened(packed, augment=False, length=10), opened(packed, length=10)
    for index in range(10):
        (one, other), lit = (plain[index], varied[index]), []
        rightly_lit = torch.equal(other["insert_gains"], other["base_gains"])
        for name in ("insert_gains", "base_gains")[rightly_lit:]:
            on = one[name] > 0
            assert torch.equal(on, other[name] > 0)
            lit.append((other[name] / one[name])[on].view(-1, 3))
        camera = torch.cat(lit)
        torch.testing.assert_close(camera, camera[:1].expand_as(camera))
        assert not torch.equal(camera[0], torch.ones(3))


def test_lights_are_where_the_scene_has_them(spheres_dataset: Path, packed: Path) -> None:
    """Back in the world by c2w, mirrored or not, whatever was cropped; equal from native, packed and other views."""
    data, native = opened(packed, views=2, length=16), opened(spheres_dataset, views=2, length=16)
    turned = set()
    for index in range(16):
        sample = data[index]
        assert same(sample, native[index])
        view = open_dataset(spheres_dataset).scene(sample["meta"]["scene"]).views[sample["meta"]["view"]]
        mirror = np.diag([-1.0, 1, 1]) if np.isclose(sample["c2w"][0, 0, 3], -view.c2w[0][3], atol=1e-5) else np.eye(3)
        turned.add(mirror[0, 0])
        for number, light in enumerate(stored_lights(spheres_dataset, sample)):
            assert KINDS[sample["light_kind"][0, number]] == light.kind
            np.testing.assert_allclose(sample["light_amount"][0, number], light.amount, rtol=1e-6)
            for pose, place, direction in zip(
                sample["c2w"].numpy(), sample["light_position"], sample["light_direction"], strict=True
            ):
                if wanted := getattr(light, "position", None):
                    world = mirror @ (pose[:3, :3] @ place[number].numpy() + pose[:3, 3])
                    np.testing.assert_allclose(world, wanted, atol=1e-5)
                along = np.array(getattr(light, "direction", (0.0, 0.0, 0.0)))
                along = along / max(np.linalg.norm(along), 1e-9)
                np.testing.assert_allclose(mirror @ pose[:3, :3] @ direction[number].numpy(), along, atol=1e-6)
    assert turned == {-1.0, 1.0}


def test_batches_of_lights(packed: Path) -> None:
    for views, group in ((1, ()), (2, (2,))):
        batch = next(iter(DataLoader(opened(packed, views=views, length=4), batch_size=4)))
        assert batch["light_position"].shape == (4, *group, 8, 3)
        assert batch["light_mask"].dtype == torch.bool


def test_larger_rigs_set_the_number(packed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("multilight.model.data.dataset.LEAST", 1)
    most = int(open_dataset(packed).table["lights"].list.len().to_numpy().max())
    assert opened(packed)[0]["light_kind"].shape == (most,)


def lights_of(folder: Path, *lights: Light, names: tuple[str, ...] = ()) -> SceneLights:
    """Read the lights of a scene with a sphere `ball` at (0, 3, 1) and a `lamp` at (1, 3, 1)."""
    bodies = [
        {"name": name, "insertable": name == "ball", "world_from_body": matrix4(translation((x, 3, 1)))}
        for name, x in (("ball", 0), ("lamp", 1))
    ]
    record = folder / "scenes" / "000000" / "scene.json"
    record.parent.mkdir(parents=True)
    record.write_text(json.dumps({"rig": LightRig(lights=lights).model_dump(), "scene": {"bodies": bodies}}))
    return read_lights(find_place(folder), 0, names or tuple(light.name for light in lights), 8)


def test_lights_in_a_rotated_cameras_axes(tmp_path: Path) -> None:
    """A camera at (0, 0, 1) that looks along +Y: its right is +X, its up +Z. Rolled by a quarter, its right is -Z."""
    white = (1.0, 1.0, 1.0)
    down = matrix4(translation((2, 0, 1)))  # an area light shines along -Z
    lights = lights_of(
        tmp_path,
        SunLight(name="sun", direction=(0, 0, -2), irradiance=white, angle=0.01),
        PointLight(name="above", position=(0, 0, 3), intensity=(1, 2, 3), radius=0.1),
        SpotLight(name="ahead", position=(0, 5, 1), direction=(3, 0, 0), intensity=white, half_angle=0.5),
        AreaLight(name="right", width=1, height=1, world_from_light=down, radiance=white),
        EmissiveLight(name="glow", body="lamp", radiance=white),
        EnvironmentLight(name="sky"),
    )
    upright = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 1], [0, 0, 0, 1]])
    places = np.array([(0, 0, 0), (0, 2, 0), (0, 0, -5), (2, 0, 0), (1, 0, -3), (0, 0, 0)])
    directions = np.array([(0, -1, 0), (0, -1, 0), (1, 0, 0), (0, -1, 0), (0, 0, 0), (0, 0, 0)])
    roll = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])  # right becomes the former down
    for c2w, rotation in ((upright, np.eye(3)), (upright @ roll, roll[:3, :3].T)):
        for mirrored, flip in ((False, 1.0), (True, -1.0)):
            seen = {name: values.numpy() for name, values in lights.seen(c2w, "ball", mirrored=mirrored).items()}
            sign = np.array([flip, 1, 1])
            np.testing.assert_allclose(seen["light_position"][:6], places @ rotation.T * sign, atol=1e-6)
            np.testing.assert_allclose(seen["light_direction"][:6], directions @ rotation.T * sign, atol=1e-6)
    assert [KINDS[kind] for kind in seen["light_kind"]] == [
        "sun", "point", "spot", "area", "emissive", "environment", "none", "none",
    ]  # fmt: skip
    assert seen["light_amount"][1].tolist() == [1, 2, 3]
    assert seen["light_size"][:3] == pytest.approx([0.01, 2 * np.arctan(0.1 / np.hypot(3, 2)), 0.0])
    assert not any(seen[name][6:].any() for name in seen)


def test_views_with_other_lights_than_their_scene(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"scene\.json has the lights \['sky'\], its views \['key'\]"):
        lights_of(tmp_path, EnvironmentLight(name="sky"), names=("key",))


def test_exposures_are_sane(packed: Path) -> None:
    data = opened(packed, augment=False, length=80)
    medians = [float(np.median(luminance(data[i]["target"].permute(1, 2, 0).numpy()))) for i in range(80)]
    assert np.quantile(medians, 0.05) > 0.1  # a spot alone leaves most of a picture black
    assert max(medians) < 0.95
    assert np.std(medians) > 0.05


@pytest.mark.parametrize("wild", [False, True])
def test_drawn_gains_and_tints(wild: bool) -> None:
    for table in tints()[1:]:
        np.testing.assert_allclose(luminance(table), 1.0, atol=2e-3)
    drawn = [draw_gains(generator(i), DAYLIGHTS, wild=wild) for i in range(400)]
    lit = np.array([(gains > 0).any(axis=1).sum() for gains in drawn])
    assert lit.min() == 1
    assert np.mean(lit == 1) == pytest.approx(0.2, abs=0.08)
    levels = np.concatenate([luminance(g[g.any(axis=1)]) for g in drawn])
    assert 1 / 3.1 < levels.min() < levels.max() < 3.1
    assert np.mean(np.log(levels)) == pytest.approx(0.0, abs=0.1)


def chroma(gains: Float32) -> Float32:
    """How far the lights that are on are from the bluest and warmest white, as |log red/green + log blue/green|."""
    red, green, blue = np.log(gains[gains.any(axis=1)]).T
    return np.abs(red + blue - 2 * green)


def test_natural_light_is_white_but_for_a_gel_now_and_then() -> None:
    """Told by what white light of no temperature has: as much more red than green as it has less blue, or so."""
    drawn = [draw_gains(generator(i), DAYLIGHTS, wild=False) for i in range(1000)]
    tinted = np.array([(chroma(gains) > 1.0).sum() for gains in drawn])
    assert tinted.max() == 1
    assert 0.01 < np.mean(tinted > 0) < 1 / 12
    wild = [draw_gains(generator(i), DAYLIGHTS, wild=True) for i in range(1000)]
    assert np.mean([(chroma(gains) > 1.0).any() for gains in wild]) > 0.1
    in_colour = np.array([0.0, 6504.0, 6504.0], np.float32)
    for i in range(300):
        gains = draw_gains(generator(i), in_colour, wild=False)
        if gains[0].any():
            assert np.ptp(gains[0]) < 1e-6 or gains[1:].any()
            assert gains[1:].any(), "light in a colour of its own is not alone"


def test_cameras_respond_monotonously() -> None:
    ramp = torch.linspace(0, 1, 257).expand(3, 1, 257)
    for number in range(50):
        bent = respond(ramp.clone(), draw_camera(generator(number)))
        assert (bent.diff(dim=-1) > 0).all()
        assert torch.equal(bent[..., 0], ramp[..., 0])
        torch.testing.assert_close(bent[..., -1], ramp[..., -1])


def test_stream_holds_the_same_samples_scene_by_scene(packed: Path) -> None:
    settings = SampleSettings(**SMALL, length=20)
    data = MultiLightDataset(packed, settings)
    wanted = sorted(data[i]["target"].numpy().tobytes() for i in range(20))
    whole = list(MultiLightStream(packed, settings))
    assert sorted(s["target"].numpy().tobytes() for s in whole) == wanted
    scenes = [s["meta"]["scene"] for s in whole]
    assert scenes == sorted(scenes)
    shares = []
    for rank, more in ((0, {}), (1, {"num_workers": 2, "multiprocessing_context": "spawn"})):
        stream = MultiLightStream(packed, settings, rank=rank, world=2)
        assert len(stream) == 10
        shares += list(DataLoader(stream, batch_size=None, **more))  # type: ignore[arg-type]
    assert sorted(s["target"].numpy().tobytes() for s in shares) == wanted


@pytest.mark.parametrize("kind", ["packed", "native"])
def test_remote_datasets_read_alike(spheres_dataset: Path, packed: Path, kind: str) -> None:
    local = packed if kind == "packed" else spheres_dataset
    memory = fsspec.filesystem("memory")
    for path in local.rglob("*"):
        if path.is_file():
            memory.pipe(f"/{kind}/{path.relative_to(local)}", path.read_bytes())
    remote, here = opened(f"memory://{kind}", length=4), opened(local, length=4)
    assert remote.source.packed == (kind == "packed")
    assert all(same(remote[i], here[i]) for i in range(4))


def test_reads_without_what_renders(spheres_dataset: Path, packed: Path, tmp_path: Path) -> None:
    """With every library blocked that only making data needs: packs, and trains from both."""
    copy = shutil.copytree(spheres_dataset, tmp_path / "native")
    code = f"""
import sys
BLOCKED = {{"bpy", "bmesh", "mathutils", "mitsuba", "drjit", "mitsuba_oidn", "trimesh", "embreex", "fcl", "igl",
           "mujoco", "pebble", "psutil", "matplotlib", "pxr", "pycolmap", "onnxruntime", "webdataset", "datasets"}}
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in BLOCKED:
            raise ImportError(f"{{name}} is not installed")
sys.meta_path.insert(0, Block())
from multilight.datagen.cli import main
from multilight.model.data import MultiLightDataset, SampleSettings
settings = SampleSettings(size=32, split=None, visible=5.0)
for root in ({str(copy)!r}, {str(packed)!r}):
    assert MultiLightDataset(root, settings)[0]["target"].shape == (3, 32, 32)
assert main(["pack", {str(copy)!r}, "--out", {str(tmp_path / "packed")!r}, "--workers", "1"]) == 0
assert main(["pack", {str(copy)!r}, "--out", {str(copy)!r}]) == 1
BLOCKED.remove("matplotlib")  # which FLIP's library imports
import multilight.model.evaluation.run, multilight.model.inference.harmonize
import multilight.model.training.stage2d, multilight.model.training.stage3d
"""
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert shown.returncode == 0, shown.stderr
    assert "error: " in shown.stderr
