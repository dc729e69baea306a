"""Make one scene: sample, render light by light, denoise, write, verify, rename."""

import contextlib
import errno
import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from multilight.datagen.backends.protocol import Backend, RenderSettings
from multilight.datagen.config.dataset import DatasetConfig, RendererName
from multilight.datagen.errors import UserError, full_disk_told
from multilight.datagen.production.denoise import AUTO_SPP
from multilight.datagen.production.stopwatch import Stopwatch
from multilight.datagen.production.view import RenderedView, SceneSetup, render_view
from multilight.datagen.storage.halves import in_half
from multilight.datagen.storage.object_variants import ALL
from multilight.datagen.storage.records import AssetCredit, SceneRecord, ViewRecord, view_file
from multilight.datagen.storage.store import ViewData, file_sha256, read_view, scene_dir, write_text, write_view
from multilight.datagen.tuples.exposure import meter_condition, thumbnail
from multilight.datagen.tuples.sheet import save_preview
from multilight.datagen.verification.views import Fault, brightness, verify_exposure, verify_pair, verify_rendered
from multilight.lights.rigs.natural import natural_rig
from multilight.lights.rigs.sample import SPHERES_KINDS, sample_rig
from multilight.lights.sample_conditions import sample_conditions
from multilight.lights.spec import EmissiveLight, EnvironmentLight, LightRig
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.files.atomic import sync
from multilight.scenes.frozen import Frozen
from multilight.scenes.geometry.contact import check_contacts
from multilight.scenes.kinds.custom import sample_custom
from multilight.scenes.kinds.outdoor import sample_outdoor
from multilight.scenes.kinds.rooms.sample import RoomSettings, sample_room
from multilight.scenes.kinds.spheres import sample_spheres
from multilight.scenes.kinds.studio import sample_studio
from multilight.scenes.kinds.tabletop import sample_tabletop
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import MeshAsset, SceneSpec
from multilight.scenes.still_life.sample import StillLifeSettings

S = TypeVar("S", bound=Frozen)
ATTEMPTS = 3
SAMPLERS = {"tabletop": sample_tabletop, "outdoor": sample_outdoor, "studio": sample_studio, "custom": sample_custom}


class SceneFailedError(UserError):
    """No attempt at a scene passed its checks."""


@dataclass(frozen=True)
class SceneMaker:
    """What is needed to make any scene of a dataset; `clock` is what its stages are timed by.

    `token` names the run whose work it is.
    """

    config: DatasetConfig
    renderer: RendererName
    root: Path
    library: AssetLibrary
    backend: Backend
    threads: int
    clock: Callable[[], float] = time.perf_counter
    token: str = ""

    @property
    def denoises(self) -> bool:
        """Whether layers are denoised: `auto` does where samples are few, and a closed form has no noise."""
        wanted = self.config.denoise == "on" or (self.config.denoise == "auto" and self.config.spp < AUTO_SPP)
        return wanted and self.renderer != "analytic"


@dataclass(frozen=True)
class Made:
    """A finished scene: its record, and the seconds that its stages took."""

    record: SceneRecord
    seconds: dict[str, float]


def sample_scene(config: DatasetConfig, library: AssetLibrary, streams: Streams) -> tuple[SceneSpec, LightRig]:
    """Draw what is there and what shines; depends on nothing but the configuration, the assets and the streams.

    Only assets of the scene's split are drawn. Raises `UserError` where no sampler makes that kind of scene.
    """
    scene, rig = _sampled(config, library, streams)
    return scene, rig if config.wild or config.kind == "imported" else natural_rig(rig)


def _sampled(config: DatasetConfig, library: AssetLibrary, streams: Streams) -> tuple[SceneSpec, LightRig]:
    kind = config.kind_of(streams.scene)
    if kind == "spheres":
        scene = sample_spheres(
            streams, index=streams.scene, width=config.width, height=config.height, views=config.views
        )
        return scene, sample_rig(streams, scene, library, kinds=SPHERES_KINDS)
    if kind == "imported":
        from multilight.datagen.usd.read import read_stage  # imports pxr, which few need

        assert config.background is not None
        found = read_stage(config.background, library)
        return found.scene, found.rig
    library = library.restricted(config.split_of(streams.scene))
    if kind == "room":
        scene = sample_room(streams, library, index=streams.scene, settings=_settings(RoomSettings, config))
        return scene, sample_rig(streams, scene, library, lights=config.lights)
    if kind not in SAMPLERS:
        raise UserError(f"scene {streams.scene}: no sampler makes kind {kind!r}; there are {', '.join(SAMPLERS)}")
    settings = _settings(StillLifeSettings, config)
    if kind != "tabletop":
        settings = settings.model_copy(update={"piles": 0.0})
    scene = SAMPLERS[kind](streams, library, index=streams.scene, settings=settings)
    return scene, sample_rig(streams, scene, library, lights=config.lights)


def _settings(kind: type[S], config: DatasetConfig) -> S:
    """Return what a sampler is told: of the configuration the keys that it knows."""
    return kind.model_validate({key: getattr(config, key) for key in kind.model_fields if hasattr(config, key)})


def make_scene(maker: SceneMaker, index: int, *, replace: bool = True) -> Made:
    """Make a scene; nothing is there under its name before it is whole and verified.

    What lies there already, since it is damaged or not whole, is replaced, or not, where another run may have made it.

    A draw is thrown away as soon as one of its views fails a check or an asset of it is broken, and drawn anew, at
    most `ATTEMPTS` times; raises `SceneFailedError` with the faults, or `UserError` when the output is full.
    """
    work = maker.root / "work" / f"{index:06d}-{os.getpid()}-{maker.token}"
    watch = Stopwatch(maker.clock)
    thrown_away: tuple[str, ...] = ()
    for attempt in range(ATTEMPTS):
        try:
            with full_disk_told(maker.root):
                work.mkdir(parents=True, exist_ok=True)
                record, faults = _write_scene(
                    maker, Streams(maker.config.seed, index, attempt), work, watch, thrown_away
                )
        except AssetError as error:
            faults = [Fault(index, None, "assets", str(error))]
        else:
            if not faults:
                final = scene_dir(maker.root, index)
                final.parent.mkdir(parents=True, exist_ok=True)
                for path in (work, *work.rglob("*")):
                    sync(path)
                if replace:
                    shutil.rmtree(final, ignore_errors=True)
                with contextlib.nullcontext() if replace else _unless_there():
                    work.rename(final)
                sync(final.parent)
                return Made(record, watch.seconds())
        finally:
            shutil.rmtree(work, ignore_errors=True)
        thrown_away += (_told(faults[0]),)
        print(f"scene {index}, attempt {attempt}: " + "; ".join(_told(fault) for fault in faults))
    raise SceneFailedError(
        f"scene {index} (seed {maker.config.seed}) failed its checks {ATTEMPTS} times: {'; '.join(thrown_away)}"
    )


@contextlib.contextmanager
def _unless_there() -> Iterator[None]:
    """Let a folder that another run has made be: it holds the same bytes."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise


def _told(fault: Fault) -> str:
    return f"{fault.check}: {'' if fault.view is None else f'view {fault.view}: '}{fault.message}"


def _write_scene(
    maker: SceneMaker, streams: Streams, work: Path, watch: Stopwatch, thrown_away: tuple[str, ...]
) -> tuple[SceneRecord, list[Fault]]:
    """Draw and render a scene into a folder, view by view; return its record, whole where no view has faults."""
    with watch.stage("draw"):
        record = _draw(maker, streams).model_copy(update={"thrown_away": thrown_away})
    with watch.stage("contacts"):  # what is imported is taken as it is
        faults = [] if maker.config.kind == "imported" else contact_faults(record.scene, maker.library)
    if faults:
        return record, faults
    setup = SceneSetup(
        maker.backend,
        record.scene,
        record.rig,
        RenderSettings(spp=maker.config.spp, threads=maker.threads),
        denoise=maker.denoises,
        keep_raw=maker.config.keep_raw,
        scratch=work,
    )
    thumbnails, brightnesses = [], []
    lights: tuple[str, ...] = ()
    before: ViewData | None = None
    for number in range(len(record.scene.cameras)):
        rendered = render_view(setup, number, watch)
        path = work / view_file(number)
        with watch.stage("write"):
            write_view(path, rendered.data)
            record = record.model_copy(update={"views": (*record.views, _view_record(record.scene, path, rendered))})
        with watch.stage("verify"):
            view = read_view(path, compact=True)
            faults = verify_rendered(record, number, view, rendered.data)
            if before is not None:
                faults += verify_pair(record, (number - 1, before), (number, view))
        if faults:
            return record, faults
        del rendered
        thumbnails.append(thumbnail(view.variants[ALL]))
        brightnesses.append(brightness(record, view))
        lights, before = view.lights, replace(view, variants={}, raw={})  # no more than the next view is held to
        del view
    seen = [[(b.median[n], b.high[n]) for b in brightnesses] for n in range(len(record.conditions))]
    metered = tuple(meter_condition(c, lights, thumbnails, s) for c, s in zip(record.conditions, seen, strict=True))
    record = record.model_copy(update={"conditions": metered})
    save_preview(work, record)
    record = record.model_copy(update={"preview_sha256": file_sha256(work / "preview.png")})
    record = record.sealed()
    write_text(work / "scene.json", record.model_dump_json(indent=1))
    return record, [f for number, found in enumerate(brightnesses) for f in verify_exposure(record, number, found)]


def contact_faults(scene: SceneSpec, library: AssetLibrary) -> list[Fault]:
    """List the bodies that lie more than a millimetre in another, and those that nothing carries.

    Spheres need no look: they are placed by their radii.
    """
    if scene.kind == "spheres":
        return []
    report = check_contacts(scene.bodies, library)
    told = [f"{o.first} and {o.second} lie {o.depth * 1000:.1f} mm in each other" for o in report.overlaps]
    told += [f"nothing carries {name}" for name in report.unsupported]
    return [Fault(scene.index, None, "contacts", message) for message in told]


def _draw(maker: SceneMaker, streams: Streams) -> SceneRecord:
    """Draw a scene, its rig and its lighting conditions: a record without views, and with nothing metered."""
    scene, rig = sample_scene(maker.config, maker.library, streams)
    return SceneRecord(
        seed=maker.config.seed,
        index=streams.scene,
        attempt=streams.attempt,
        split=maker.config.split_of(streams.scene),
        renderer=maker.renderer,
        denoised=maker.denoises,
        scene=scene,
        scene_sha256=scene.sha256(),
        rig=rig,
        rig_sha256=rig.sha256(),
        conditions=sample_conditions(streams("conditions"), rig, maker.config.conditions, wild=maker.config.wild),
        views=(),
        assets=credits_of(scene, rig, maker.library),
    )


def credits_of(scene: SceneSpec, rig: LightRig, library: AssetLibrary) -> tuple[AssetCredit, ...]:
    """List the assets a scene uses, with creator and licence, sorted by id.

    A model's own textures come under the model, a derived normal map under the texture it was derived from.
    """
    used = {body.geometry.asset for body in scene.bodies if isinstance(body.geometry, MeshAsset)}
    used |= {light.map for light in rig.lights if isinstance(light, EnvironmentLight) and light.map}
    textures = {m.base_color_texture.image for b in scene.bodies for m in b.materials if m.base_color_texture}
    textures |= {light.texture.image for light in rig.lights if isinstance(light, EmissiveLight) and light.texture}
    used |= textures & {info.id for info in library.list("texture")}
    infos = (library.info(asset) for asset in sorted(used))
    return tuple(AssetCredit(id=i.id, pack=i.pack, name=i.name, creator=i.creator, licence=i.licence) for i in infos)


def _view_record(scene: SceneSpec, path: Path, rendered: RenderedView) -> ViewRecord:
    number = int(path.stem)
    camera = scene.cameras[number]
    return ViewRecord(
        file=view_file(number),
        file_sha256=file_sha256(path),
        bytes=path.stat().st_size,
        width=camera.width,
        height=camera.height,
        K=tuple(tuple(row) for row in camera.intrinsics().tolist()),
        c2w=camera.c2w,
        additivity=round(rendered.additivity, 9),
        energy=rendered.energy,
        residuals=rendered.residuals,
        pixels={name: float(in_half(alpha).sum(dtype=np.float64)) for name, alpha in rendered.data.coverage.items()},
    )
