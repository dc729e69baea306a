"""Make one scene: sample, render light by light, denoise, write, verify, rename."""

import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datagen.backends import Backend, RendererName, RenderJob, RenderSettings
from datagen.config import DatasetConfig
from datagen.denoise import denoise_all, denoise_foreground, denoise_without, foreground_layers
from datagen.errors import UserError, full_disk_told
from datagen.exposure import meter_condition, thumbnail
from datagen.layers import Float32, LayerStack
from datagen.records import AssetCredit, SceneRecord, ViewRecord
from datagen.sheet import save_preview
from datagen.store import ViewData, file_sha256, scene_dir, view_file, write_text, write_view
from datagen.verify import Fault, verify_scene
from lights.conditions import sample_conditions
from lights.rigs import SPHERES_KINDS, sample_rig
from lights.spec import EnvironmentLight, LightRig
from scenes.assets.library import AssetError, AssetLibrary
from scenes.spec import MeshAsset, SceneSpec
from scenes.spheres import sample_spheres
from scenes.streams import Streams
from scenes.tabletop import TabletopSettings, sample_tabletop

ATTEMPTS = 3


class SceneFailedError(UserError):
    """No attempt at a scene passed its checks."""


@dataclass(frozen=True)
class Maker:
    """What is needed to make any scene of a dataset."""

    config: DatasetConfig
    renderer: RendererName
    root: Path
    library: AssetLibrary
    backend: Backend
    threads: int

    @property
    def denoises(self) -> bool:
        """Whether layers are denoised: a closed form has no noise."""
        return self.config.denoise and self.renderer != "analytic"


def sample_scene(config: DatasetConfig, library: AssetLibrary, streams: Streams) -> tuple[SceneSpec, LightRig]:
    """Draw what is there and what shines; depends on nothing but the configuration, the assets and the streams."""
    if config.kind == "spheres":
        scene = sample_spheres(
            streams, index=streams.scene, width=config.width, height=config.height, views=config.views
        )
        return scene, sample_rig(streams, scene, library, kinds=SPHERES_KINDS)
    settings = TabletopSettings(
        width=config.width,
        height=config.height,
        views=config.views,
        insertable=config.insertable,
        objects=config.objects,
    )
    scene = sample_tabletop(streams, library, index=streams.scene, settings=settings)
    return scene, sample_rig(streams, scene, library)


def make_scene(maker: Maker, index: int) -> Path:
    """Make a scene and return its folder; nothing is there under that name before it is whole and verified.

    A draw whose checks fail, or that holds a broken asset, is thrown away and drawn anew, at most `ATTEMPTS`
    times; raises `SceneFailedError` with the faults, or `UserError` when the output is full.
    """
    work = maker.root / "work" / f"{index:06d}-{os.getpid()}"
    faults: list[Fault] = []
    for attempt in range(ATTEMPTS):
        try:
            with full_disk_told(maker.root):
                _write_scene(maker, index, attempt, work)
                faults = verify_scene(work)
        except AssetError as error:
            faults = [Fault(index, None, "assets", str(error))]
        else:
            if not faults:
                final = scene_dir(maker.root, index)
                final.parent.mkdir(parents=True, exist_ok=True)
                shutil.rmtree(final, ignore_errors=True)  # what lies there has no scene.json
                work.rename(final)
                return final
        finally:
            shutil.rmtree(work, ignore_errors=True)
        print(f"scene {index}, attempt {attempt}: " + "; ".join(f"{f.check}: {f.message}" for f in faults))
    first = faults[0]
    raise SceneFailedError(
        f"scene {index} (seed {maker.config.seed}) failed its checks {ATTEMPTS} times; "
        f"the last: view {first.view}: {first.check}: {first.message}"
    )


def _write_scene(maker: Maker, index: int, attempt: int, work: Path) -> None:
    streams = Streams(maker.config.seed, index, attempt)
    scene, rig = sample_scene(maker.config, maker.library, streams)
    assets = credits_of(scene, rig, maker.library)
    records, thumbnails = [], []
    for view in range(len(scene.cameras)):
        data, additivity = render_view(maker, scene, rig, view)
        path = work / view_file(view)
        write_view(path, data)
        records.append(_view_record(scene, view, path, data, additivity))
        thumbnails.append(thumbnail(data.variants["all"]))
    conditions = sample_conditions(streams("conditions"), rig, maker.config.conditions)
    record = SceneRecord(
        seed=maker.config.seed,
        index=index,
        attempt=attempt,
        renderer=maker.renderer,
        denoised=maker.denoises,
        scene=scene,
        scene_sha256=scene.sha256(),
        rig=rig,
        rig_sha256=rig.sha256(),
        conditions=tuple(meter_condition(c, rig.names, thumbnails) for c in conditions),
        views=tuple(records),
        assets=assets,
    )
    save_preview(work, record)
    write_text(work / "scene.json", record.model_dump_json(indent=1))


def render_view(maker: Maker, scene: SceneSpec, rig: LightRig, view: int) -> tuple[ViewData, float]:
    """Render all variants of a view; also returns how far the raw layers are from the combined render."""
    settings = RenderSettings(spp=maker.config.spp, threads=maker.threads)

    def render(variant: str) -> LayerStack:
        return maker.backend.render(RenderJob(scene, rig, settings, view, variant))

    everything = render("all")
    assert everything.geometry is not None
    clean = denoise_all(everything) if maker.denoises else everything.radiance
    variants: dict[str, Float32] = {"all": clean}
    foregrounds = _within_pixels({name: render(f"foreground_{name}") for name in scene.insertable})
    coverage = {name: stack.coverage for name, stack in foregrounds.items() if stack.coverage is not None}
    for name, foreground in foregrounds.items():
        without = render(f"without_{name}")
        if maker.denoises:
            variants[f"without_{name}"] = denoise_without(without, everything, clean)
            variants[f"foreground_{name}"] = denoise_foreground(foreground, clean)
        else:
            variants[f"without_{name}"] = without.radiance
            variants[f"foreground_{name}"] = foreground_layers(foreground, clean)
    free = np.clip(1.0 - sum(coverage.values()), 0.0, 1.0)
    geometry = replace(everything.geometry, environment=np.minimum(everything.geometry.environment, free))
    data = ViewData(rig.names, variants, coverage, geometry, everything.combined)
    return data, additivity_residual(everything)


def _within_pixels(foregrounds: dict[str, LayerStack]) -> dict[str, LayerStack]:
    """Scale objects down where together they cover more than the pixel.

    Each is rendered on its own, so where see-through things overlap the estimates need not add up.
    """
    total = np.maximum(sum(stack.coverage for stack in foregrounds.values() if stack.coverage is not None), 1.0)
    return {
        name: replace(stack, coverage=stack.coverage / total, radiance=stack.radiance / total[..., None])
        for name, stack in foregrounds.items()
        if stack.coverage is not None
    }


def additivity_residual(stack: LayerStack) -> float:
    """Return the largest |sum of layers - combined| / (combined + its mean) of a raw render."""
    total = stack.radiance.sum(axis=0, dtype=np.float64)
    scale = stack.combined + max(float(stack.combined.mean()), 1e-12)
    return float((np.abs(total - stack.combined) / scale).max())


def credits_of(scene: SceneSpec, rig: LightRig, library: AssetLibrary) -> tuple[AssetCredit, ...]:
    """List the assets a scene uses, with creator and licence, sorted by id.

    A model's own textures come under the model, a derived normal map under the texture it was derived from.
    """
    used = {body.geometry.asset for body in scene.bodies if isinstance(body.geometry, MeshAsset)}
    used |= {light.map for light in rig.lights if isinstance(light, EnvironmentLight) and light.map}
    textures = {m.base_color_texture.image for b in scene.bodies for m in b.materials if m.base_color_texture}
    used |= textures & {info.id for info in library.list("texture")}
    infos = (library.info(asset) for asset in sorted(used))
    return tuple(AssetCredit(id=i.id, pack=i.pack, name=i.name, creator=i.creator, licence=i.licence) for i in infos)


def _view_record(scene: SceneSpec, view: int, path: Path, data: ViewData, additivity: float) -> ViewRecord:
    camera = scene.cameras[view]
    energy = data.variants["all"].sum(axis=0).mean() / max(float(data.combined.mean()), 1e-12)
    return ViewRecord(
        file=view_file(view),
        file_sha256=file_sha256(path),
        bytes=path.stat().st_size,
        width=camera.width,
        height=camera.height,
        K=tuple(tuple(row) for row in camera.intrinsics().tolist()),
        c2w=camera.c2w,
        additivity=round(additivity, 9),
        energy=round(float(energy), 5),
    )
