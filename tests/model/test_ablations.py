"""Ablations: blind networks see nothing of what is withheld, variants are fair, tables say what was found."""

import copy
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from multilight.datagen.config.loading import joined
from multilight.datagen.errors import UserError
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.model.ablations.run import (
    AVERAGED,
    CARRIED,
    COMPOSITE,
    STAGE_2D,
    Run,
    ablate,
    base_values,
    fewer_scenes,
    glowing_scenes,
    stored_lighting,
    variants,
)
from multilight.model.ablations.settings import AblationSettings
from multilight.model.ablations.table import rows_of, spread, write_tables
from multilight.model.cli import COMMANDS
from multilight.model.configs.stage2d import Input, NetworkConfig, TrainingConfig
from multilight.model.configs.stage3d import SLIM3D, Layout, SceneNetworkConfig, SceneTrainingConfig
from multilight.model.gaussians.splat_scene import SplatScene, splat_scene
from multilight.model.inference.harmonize import harmonize
from multilight.model.networks.checkpoint import (
    Progress,
    load_checkpoint,
    load_network,
    load_network3d,
    newest_checkpoint,
    save_checkpoint,
    save_network,
)
from multilight.model.networks.compositing2d import Compositing2D
from multilight.model.networks.compositing3d import Compositing3D, harmonize_scene, scene_network
from multilight.model.networks.points3d import MEMBERS, PointTransformer, clusters, point_features
from multilight.scenes.gaussians.from_views import normals_from_depth

TINY = {"body": "attention", "width": 16, "heads": 2, "groups": 1, "blocks": 2, "window": 4, "pooled": 2}
TINY3D = {**TINY, "stride": 2}
SIDE = 32


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def scene(spheres_dataset: Path) -> SplatScene:
    source = open_dataset(spheres_dataset)
    record = source.scene(0)
    depths = np.stack([source.view(record, number).geometry.z_depth for number in range(3)])
    return splat_scene(record.scene.cameras, depths, side=SIDE)


def random_network(**changes: Any) -> Compositing2D:
    """A network whose head is not zero, so that whatever it sees shows."""
    torch.manual_seed(0)
    network = Compositing2D(NetworkConfig.model_validate(TINY | changes)).eval()
    for parameter in network.head.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    return network


def pictures(seed: int, size: int = 40) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(seed)
    composite, background = torch.rand(2, 1, 3, size, size, generator=generator)
    depth, mask = torch.rand(2, 1, 1, size, size, generator=generator)
    return composite, background, depth, mask


@pytest.mark.parametrize("head", ["light", "gain", "residual", "direct"])
@pytest.mark.parametrize(("blind", "place"), [("background", 1), ("depth", 2)])
def test_what_is_withheld_reaches_no_output(head: str, blind: Input, place: int) -> None:
    given, other = list(pictures(0)), pictures(1)
    changed = [*given[:place], other[place], *given[place + 1 :]]
    for name, same in ((blind, True), ("depth" if blind == "background" else "background", False)):
        network = random_network(head=head, blind=[name])
        assert torch.equal(network(*given), network(*changed)) is same, name
    assert not torch.equal(random_network(head=head)(*given), random_network(head=head)(*changed))


def test_large_pictures_and_missing_masks_leak_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond the size that a network sees at once, gains are applied by other code: it is blind as well."""
    monkeypatch.setattr("multilight.model.inference.harmonize.WHOLE", 32)
    monkeypatch.setattr(Compositing2D, "size", 32)
    monkeypatch.setattr("multilight.model.inference.harmonize.OVERLAP", 8)
    composite, background, depth, mask = (p[0].permute(1, 2, 0).numpy() for p in pictures(0))
    for head in ("light", "gain", "residual"):
        network = random_network(head=head, blind=["background", "depth"])
        first = harmonize(network, composite, background, depth[..., 0], mask=mask[..., 0])
        again = harmonize(network, composite, background[::-1], depth[::-1, :, 0], mask=mask[..., 0])
        np.testing.assert_array_equal(first, again)
        with pytest.raises(UserError, match="blind to the background needs the object's mask"):
            harmonize(network, composite, background, depth[..., 0])


def test_untrained_and_blind_returns_the_composite() -> None:
    """The gain head takes the composite apart by the mask alone, and puts it together again."""
    given = pictures(2)
    network = Compositing2D(NetworkConfig.model_validate(TINY | {"blind": ["background"]})).eval()
    torch.testing.assert_close(network(*given), given[0], atol=1e-5, rtol=1e-5)


def test_older_weights_and_checkpoints_still_load(tmp_path: Path) -> None:
    """Files from before a key was known say nothing of it: its default holds."""
    text = NetworkConfig().model_dump(mode="json")
    assert NetworkConfig.model_validate({k: v for k, v in text.items() if k != "blind"}) == NetworkConfig()
    older = {k: v for k, v in SLIM3D.model_dump(mode="json").items() if k not in ("blind", "layout", "order", "carry")}
    assert SceneNetworkConfig.model_validate(older) == SLIM3D
    config = TrainingConfig.model_validate({"out": tmp_path, "network": TINY, "steps": 1, "data": {"train": "x"}})
    network = Compositing2D(config.network)
    parts: dict[str, Any] = {
        "model": network,
        "average": copy.deepcopy(network),
        "optim": torch.optim.AdamW(network.parameters()),
    }
    save_checkpoint(tmp_path, config, Progress(3, 1.0), **parts)
    path = newest_checkpoint(tmp_path)
    assert path is not None
    record = json.loads(path.read_text())
    del record["config"]["network"]["blind"]
    path.write_text(json.dumps(record))
    assert load_checkpoint(path, config, **parts) == Progress(3, 1.0)
    said = {k: v for k, v in config.network.model_dump(mode="json").items() if k != "body"}
    tensors = {name: tensor.contiguous() for name, tensor in network.state_dict().items()}
    for size, fault in (("96", ""), ("0", "size in their header is 0"), ("1e9", "size in their header is 1e9")):
        save_file(tensors, tmp_path / "w.safetensors", {"network": json.dumps(said), "size": size})
        if fault:
            with pytest.raises(UserError, match=fault):
                load_network(tmp_path / "w.safetensors")
            continue
        loaded = load_network(tmp_path / "w.safetensors")
        assert loaded.config == config.network, "there was but one body"
        assert loaded.size == 96
    save_network(tmp_path / "w.safetensors", network, config.network, {})
    assert load_network(tmp_path / "w.safetensors").size == 128


def test_transformer_has_as_many_parameters_as_the_map_network() -> None:
    on_map, on_points = (
        sum(p.numel() for p in scene_network(SLIM3D.model_copy(update={"layout": layout})).parameters())
        for layout in ("map", "points")
    )
    assert abs(on_points / on_map - 1.0) < 0.03


def test_clusters_are_a_partition_into_compact_parts() -> None:
    points = torch.rand(4096, 3, generator=torch.Generator().manual_seed(0))
    groups = clusters(points)
    assert groups.shape == (4096 // MEMBERS, MEMBERS)
    assert groups.flatten().sort().values.tolist() == list(range(4096))
    sides = points[groups].amax(1) - points[groups].amin(1)
    assert sides.max() < 0.5
    assert sides.mean() < 1.5 * (MEMBERS / 4096) ** (1 / 3)  # an even cube's side


def random_points(scene: SplatScene) -> tuple[PointTransformer, torch.Tensor, torch.Tensor]:
    torch.manual_seed(0)
    network = scene_network(SceneNetworkConfig.model_validate({**TINY3D, "layout": "points"})).eval()
    assert isinstance(network, PointTransformer)
    torch.nn.init.normal_(network.head.weight, std=0.02)
    composite, carried = torch.rand(2, len(scene.cells), 3)
    return network, composite, 0.4 + 0.2 * carried


def test_transformer_knows_no_map(scene: SplatScene) -> None:
    """Neither where cells lie on the map nor how Gaussians are numbered changes what a Gaussian gets."""
    network, composite, carried = random_points(scene)
    found = network.colors(scene, composite, carried)
    elsewhere = replace(scene, cells=scene.cells.flip(0))
    assert torch.equal(network.colors(elsewhere, composite, carried), found)
    means = torch.from_numpy(scene.gaussians.gaussians.means) + 1e-4 * torch.rand(len(carried), 3)  # no ties
    shuffled = torch.randperm(len(means))
    torch.testing.assert_close(
        network(composite[shuffled], carried[shuffled], means[shuffled]),
        network(composite, carried, means)[shuffled],
        atol=1e-5,
        rtol=1e-5,
    )


def test_transformer_sees_places_and_all_the_scene(scene: SplatScene) -> None:
    network, composite, carried = random_points(scene)
    means = torch.from_numpy(scene.gaussians.gaussians.means)
    found = network(composite, carried, means)
    stretched = means * torch.tensor([1.0, 3.0, 1.0])
    assert not torch.allclose(network(composite, carried, stretched), found, atol=1e-4)
    darker = composite.clone()
    darker[0] = 0.0
    changed = (network(darker, carried, means) - found).abs().amax(dim=1) > 0
    assert changed.float().mean() > 0.9


def test_point_features_are_places_and_normals(scene: SplatScene, spheres_dataset: Path) -> None:
    features = point_features(scene)
    means = scene.gaussians.gaussians.means
    size = np.ptp(means, axis=0).max()
    np.testing.assert_allclose(features[:, :3] * size / 2, means - means.min(0) - size / 2, atol=1e-5 * size)
    torch.testing.assert_close(features[:, 3:].norm(dim=1), torch.ones(len(features)))
    source = open_dataset(spheres_dataset)
    record = source.scene(0)
    normals = np.stack(
        [normals_from_depth(c, source.view(record, n).geometry.z_depth) for n, c in enumerate(record.scene.cameras)]
    ).reshape(-1, 3)[scene.sources]
    agreement = (features[:, 3:].numpy() * normals).sum(axis=1)
    assert np.quantile(agreement, 0.02) > 0.99


@pytest.mark.parametrize("layout", ["map", "map+points", "points"])
def test_every_layout_starts_at_the_carried_colours_and_is_read_back(
    scene: SplatScene, tmp_path: Path, layout: Layout
) -> None:
    config = SceneNetworkConfig.model_validate({**TINY3D, "layout": layout, "order": "morton"})
    network = scene_network(config).eval()
    images = 0.2 + 0.5 * torch.rand(3, 3, scene.height, scene.width)
    colors, views = harmonize_scene(network, scene, images, images, images)
    torch.testing.assert_close(colors, scene.carry(images), atol=1e-5, rtol=1e-5)
    for parameter in network.head.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    save_network(tmp_path / "w.safetensors", network, config, {})
    again = load_network3d(tmp_path / "w.safetensors")
    assert again.config == config
    assert torch.equal(
        harmonize_scene(again, scene, images, images, images)[0],
        harmonize_scene(network, scene, images, images, images)[0],
    )
    assert views.shape == images.shape


def test_point_features_are_used(scene: SplatScene) -> None:
    torch.manual_seed(0)
    network = Compositing3D(SceneNetworkConfig.model_validate({**TINY3D, "layout": "map+points"})).eval()
    torch.nn.init.normal_(network.head.weight, std=0.1)
    composite, carried = torch.rand(2, len(scene.cells), 3)
    found = scene.gaussians.gaussians
    moved = replace(scene.gaussians, gaussians=replace(found, means=found.means[::-1].copy()))
    assert not torch.equal(
        network.colors(scene, composite, carried), network.colors(replace(scene, gaussians=moved), composite, carried)
    )


def scenes_in(values: dict[str, Any]) -> set[int]:
    return set(map(int, values["data"]["where"].removeprefix("index IN (").removesuffix(")").split(",")))


def test_fewer_scenes_nest_and_are_drawn() -> None:
    numbers = list(range(3, 43))
    found = [scenes_in(values) for values in fewer_scenes(numbers, 0).values()]
    assert [len(scenes) for scenes in found] == [5, 10, 20, 40]
    assert found[0] < found[1] < found[2] < found[3] == set(numbers)
    assert scenes_in(next(iter(fewer_scenes(numbers, 1).values()))) != found[0]


def test_of_many_scenes_the_steps_are_wider() -> None:
    assert [len(scenes_in(values)) for values in fewer_scenes(range(2042), 0).values()] == [45, 186, 681, 2042]


def test_conditions_rendered_anew_leave_few_scenes() -> None:
    numbers = list(range(3, 43))
    drawn, stored, anew, fifth, fifth_anew = stored_lighting(numbers, 12, 0).values()
    assert drawn == {}
    assert stored == {"data": {"lighting": "stored"}}
    assert anew["data"]["lighting"] == fifth_anew["data"]["lighting"] == "stored"
    # Of 40 and 8 scenes, whose layers cost 2.7 renders each instead of 12.
    assert [len(scenes_in(values)) for values in (anew, fifth, fifth_anew)] == [9, 8, 2]
    assert scenes_in(fifth_anew) < scenes_in(fifth) < scenes_in(anew) < set(numbers)
    assert "lighting" not in fifth["data"]
    assert scenes_in(list(stored_lighting(numbers, 12, 1).values())[2]) != scenes_in(anew)
    assert [len(scenes_in(values)) for values in list(stored_lighting(numbers[:10], 12, 0).values())[2:]] == [2, 2, 1]
    with pytest.raises(UserError, match=r"9 scenes to train on: .* needs 10; make more"):
        stored_lighting(numbers[:9], 12, 0)


def test_emissive_trainings_have_as_many_scenes() -> None:
    glowing, plain = [1, 2, 3, 4, 5, 6, 7, 8, 9], [11, 12, 13, 14, 15, 16]
    without, mixed = (scenes_in(values) for values in glowing_scenes(glowing, plain, 0).values())
    assert without == set(plain)
    assert len(mixed) == len(plain)
    assert len(mixed & set(glowing)) == 3
    with pytest.raises(UserError, match="0 scenes to train on have something that glows, 6 have not"):
        glowing_scenes([], plain, 0)


def settings(dataset: Path, out: Path, name: Any, **changes: Any) -> AblationSettings:
    every: dict[str, Any] = {
        "steps": 2, "seeds": 2, "size": 32, "batch": 2, "splits": ("train", "val", "test", "test_ood"), "groups": 2,
        "workers": 0, "device": "cpu",
    }  # fmt: skip
    return AblationSettings(name, str(dataset), out, **every | changes)


def tiny_base(chosen: AblationSettings) -> dict[str, Any]:
    network = TINY3D if chosen.name == "order" else TINY
    return joined(base_values(chosen), {"network": network, "warmup": 1, "data": {"validation_samples": 2}})


def test_ablation_trains_evaluates_resumes_and_tells(spheres_dataset: Path, tmp_path: Path) -> None:
    chosen = settings(spheres_dataset, tmp_path, "inputs")
    runs, found = ablate(chosen, tiny_base(chosen))
    assert [run.steps for run in runs] == [2] * 8
    rows = rows_of(runs, found)
    assert [row.name for row in rows] == [COMPOSITE, *variants(chosen, 0)]
    assert rows[0].figures["object and effect"][0] == found.means(COMPOSITE)["object and effect"]["PSNR"]
    assert all(len(row.figures["image"]) == 2 for row in rows[1:])
    again, same = ablate(chosen, tiny_base(chosen))
    assert [run.seconds for run in again] == [run.seconds for run in runs]  # nothing was trained anew
    assert all(same.means(run.method) == found.means(run.method) for run in runs)
    text = write_tables("Inputs", runs, found, {"data": "spheres"}, tmp_path)
    assert f"| without depth | {runs[0].parameters:,} | 2 |" in text
    record = json.loads((tmp_path / "table.json").read_text())
    assert record["rows"][1]["figures"]["object"] == list(rows[1].figures["object"])
    with pytest.raises(UserError, match="holds a comparison with steps = 2, now it is 3; choose another --out"):
        ablate(replace(chosen, steps=3), tiny_base(replace(chosen, steps=3)))


def test_variants_differ_in_nothing_else(spheres_dataset: Path, tmp_path: Path) -> None:
    """What each training was told differs from the base in the one place that its name says."""
    may = {"head": {"network", "loss"}, "inputs": {"network"}, "lighting": {"data"}, "scenes": {"data"}}
    for name, keys in may.items():
        chosen = settings(spheres_dataset, tmp_path / name, name)
        base = base_values(chosen)
        # The dataset has too few scenes to compare lightings on.
        found = stored_lighting(range(40), 12, 0) if name == "lighting" else variants(chosen, 0)
        told = [TrainingConfig.model_validate(joined(base, v) | {"out": "o"}) for v in found.values()]
        plain = TrainingConfig.model_validate(base | {"out": "o"})
        for config in told:
            different = {k for k in TrainingConfig.model_fields if getattr(config, k) != getattr(plain, k)}
            assert different <= keys
        assert len(set(map(TrainingConfig.canonical_json, told))) == len(told)
    assert told[0].data.validation_split == plain.data.validation_split


def test_order_compares_networks_on_the_2d_stage(spheres_dataset: Path, tmp_path: Path) -> None:
    network = NetworkConfig.model_validate(TINY)
    save_network(tmp_path / "2d.safetensors", Compositing2D(network), network, {})
    missing = settings(spheres_dataset, tmp_path / "out", "order")
    with pytest.raises(UserError, match="--weights-2d"):
        base_values(missing)
    chosen = replace(missing, weights_2d=tmp_path / "2d.safetensors", seeds=1, steps=1, size=64)
    base = joined(tiny_base(chosen), {"side": 32})
    runs, found = ablate(chosen, base)
    configs = [load_network3d(run.weights).config for run in runs]
    assert [(c.layout, c.order, c.carry) for c in configs] == [
        ("map", "hilbert", "pixel"), ("map", "morton", "pixel"), ("map", "arbitrary", "pixel"),
        ("points", "hilbert", "pixel"), ("map+points", "hilbert", "pixel"), ("map", "hilbert", "average"),
    ]  # fmt: skip
    rows = {row.name: row for row in rows_of(runs, found)}
    assert list(rows)[:4] == [COMPOSITE, STAGE_2D, AVERAGED, CARRIED]
    # untrained, the 2D stage returns the composite
    assert rows[STAGE_2D].figures["image"] == pytest.approx(rows[COMPOSITE].figures["image"], abs=0.01)
    assert all(np.isfinite(row.figures["views disagree by"]).all() for row in rows.values())
    assert "views disagree by" in write_tables("Order", runs, found, {}, tmp_path)
    stored = json.loads((tmp_path / "out/ablation.json").read_text())
    assert SceneTrainingConfig.model_validate(base | {"out": "o"}).side == stored["side"]


def test_spread_is_mean_and_half_the_range() -> None:
    assert spread((1.0, 2.0, 4.0), 2) == "2.33 ± 1.50"
    assert spread((1.0,), 1) == "1.0"
    assert spread((math.nan,), 1) == spread((), 1) == "–"


def test_runs_are_told_apart_by_seed() -> None:
    run = Run("gain", 0, Path(), 1, 1, 1.0, {})
    assert run.method != replace(run, seed=1).method


def test_command_refuses_what_makes_no_sense(spheres_dataset: Path, tmp_path: Path) -> None:
    command = COMMANDS["ablate"]
    with pytest.raises(UserError, match="either --steps or --minutes"):
        command("head", str(spheres_dataset), out=tmp_path, steps=1, minutes=1.0).run()
    with pytest.raises(UserError, match="--seeds 0 must be more than 0"):
        command("head", str(spheres_dataset), out=tmp_path, seeds=0).run()
    with pytest.raises(UserError, match="no scene of test_ood; its scenes are of train: choose others with --splits"):
        command("head", str(spheres_dataset), out=tmp_path, splits=("test_ood",)).run()
