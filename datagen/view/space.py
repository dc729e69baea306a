"""A scene in space, in the browser: what its views see as Gaussians, relit; cameras, lights, boxes of bodies."""

import contextlib
import threading
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
import viser
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.storage.object_variants import ALL
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData
from multilight.datagen.tuples import compose
from multilight.datagen.tuples.mixing import checked_scene
from multilight.datagen.view.server import LOOPBACK, PORT
from multilight.lights.display.tonemap import to_display
from multilight.lights.relight import mix
from multilight.lights.spec import AreaLight, Light, PointLight, SpotLight, SunLight
from multilight.scenes.arrays import Float64
from multilight.scenes.colour import srgb_encode
from multilight.scenes.gaussians.from_views import SceneGaussians, gaussians_from_views
from multilight.scenes.poses import about_z

SIDE = 256
"""Gaussians a side of their map."""
FINE = 64.0
"""Covariances travel as half floats, which hold those of millimetres if the scene is that much larger."""
TO_OPENCV = np.diag([1.0, -1.0, -1.0])
MARK, LONG, AWAY = 0.03, 0.25, 1.5
"""Metres: radius of what stands for a small light, length of arrows, how far from the middle a sun is drawn."""
BACK, ASIDE = 1.2, 0.5
"""The page begins so many times as far away as the furthest camera, and so far [rad] to its side."""
AMBER = (255, 179, 92)


class Space:
    """A server of a dataset's scenes in space, on the loopback interface; `address` is where."""

    def __init__(self, source: DatasetSource, port: int | None) -> None:
        """Show the first scene on a port, or on `PORT` or a free one after it.

        Raises `UserError` where the port is taken, `StoreError` where the scene cannot be read.
        """
        self._source, self._lock = source, threading.Lock()
        with contextlib.redirect_stdout(None):  # it tells what it does
            self.server = viser.ViserServer(LOOPBACK, PORT if port is None else port, label="In space", verbose=False)
        found = self.server.get_port()
        if port not in (None, 0, found):
            self.__exit__()
            raise UserError(f"--port {port} cannot be used: it is taken; choose another, or none")
        self.address = f"http://{LOOPBACK}:{found}/"
        gui = self.server.gui
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, brand_color=AMBER)
        self.server.scene.set_up_direction("+z")
        self._scene = gui.add_number("Scene", source.indices[0], min=source.indices[0], max=source.indices[-1], step=1)
        self._lighting = gui.add_dropdown("Lighting", ["all"])
        self._shown = {name: gui.add_checkbox(name, name != "boxes") for name in ("cameras", "lights", "boxes")}
        self._scene.on_update(self._turn)
        self._lighting.on_update(lambda _: self.relight(self._lighting.value))
        for name, box in self._shown.items():
            box.on_update(lambda _, name=name, box=box: setattr(self._groups[name], "visible", box.value))
        self.show(source.indices[0])

    def __enter__(self) -> Self:
        """Return the server, which has begun."""
        return self

    def __exit__(self, *error: object) -> None:
        """End it."""
        with contextlib.redirect_stdout(None):
            self.server.stop()

    def serve_forever(self) -> None:
        """Wait; the server has its own threads."""
        self.server.sleep_forever()

    def show(self, index: int) -> None:
        """Show a scene in place of the one before."""
        record = checked_scene(self._source, index)
        views = list(self._source.views(record))
        found = seen_gaussians(record, views)
        shape = found.gaussians
        axes = Rotation.from_quat(np.roll(shape.quats, -1, axis=1)).as_matrix() * shape.scales[:, None, :]
        with self._lock, self.server.atomic():
            space = self.server.scene
            space.reset()
            self._record = record
            self._lights = views[0].lights
            self._layers = np.empty((len(self._lights), 1, len(shape), 3), np.float32)
            for number, view in enumerate(views):
                here = found.sources[:, 0] == number
                layers = view.variants[ALL].reshape(len(self._lights), -1, 3)
                self._layers[:, 0, here] = layers[:, found.sources[here, 1]]
            self._groups = {
                name: space.add_frame(name, show_axes=False, visible=box.value) for name, box in self._shown.items()
            }
            spread = FINE**2 * axes @ axes.transpose(0, 2, 1)
            grey, opaque = np.ones_like(shape.means), shape.opacities[:, None]
            self._gaussians = space.add_gaussian_splats(
                "seen", FINE * shape.means, spread, grey, opaque, scale=1 / FINE
            )
            middle = np.median(shape.means[found.objects >= 0], axis=0)
            boxes = boxes_of(record, views, found)
            for name, (low, high, pose) in boxes.items():
                place = (pose @ [*(low + high) / 2, 1.0])[:3]
                size = np.linalg.norm(pose[:3, 0]) * (high - low)
                wxyz = quaternion(pose)
                space.add_box(f"boxes/{name}", AMBER, size, wireframe=True, position=place, wxyz=wxyz)
                space.add_label(f"boxes/{name}/label", name.replace("_", " "), position=(0, 0, size[2] / 2))
            self._add_cameras(views)
            for light in record.rig.lights:
                self._add_light(light, middle)
            eyes = np.stack([camera.pose()[:3, 3] for camera in record.scene.cameras])
            away = eyes[np.argmax(np.linalg.norm(eyes - middle, axis=1))] - middle
            self.server.initial_camera.position = middle + BACK * about_z(ASIDE)[:3, :3] @ away
            self.server.initial_camera.look_at = middle
            self._lighting.options = [condition.name for condition in record.conditions]
        self.relight(record.conditions[0].name)

    def _turn(self, event: Any) -> None:
        """Show the scene that somebody asks for, or say why not."""
        try:
            self.show(int(self._scene.value))
        except (UserError, StoreError) as error:
            event.client.add_notification(f"Scene {self._scene.value}", str(error))

    def relight(self, name: str) -> None:
        """Show the Gaussians under a stored condition."""
        radiance = mix(self._layers, self._lights, self._record.condition(name))
        self._gaussians.rgbs = to_display(radiance)[0] / 255.0

    def _add_cameras(self, views: Sequence[ViewData]) -> None:
        for number, (camera, view) in enumerate(zip(self._record.scene.cameras, views, strict=True)):
            picture = to_display(compose.target(view, self._record.conditions[0]))
            pose = camera.pose()
            frustum = self.server.scene.add_camera_frustum(
                f"cameras/{number}",
                2 * np.arctan(camera.height / camera.fy / 2),
                camera.width / camera.height,
                scale=0.1,
                thickness=0.004,
                color=AMBER,
                image=picture,
                position=pose[:3, 3],
                wxyz=quaternion(pose[:3, :3] @ TO_OPENCV),
            )
            frustum.on_click(self._look_through)

    def _look_through(self, event: Any) -> None:
        event.client.camera.wxyz, event.client.camera.position = event.target.wxyz, event.target.position

    def _add_light(self, light: Light, middle: Float64) -> None:
        """Draw a light where it is, and whither it shines; environments are everywhere, what glows is in its box."""
        space, name = self.server.scene, f"lights/{light.name}"
        amount = np.asarray(light.amount)
        colour = (255 * srgb_encode(amount / max(amount.max(), 1e-9))).astype(int)
        match light:
            case AreaLight():
                pose = np.asarray(light.world_from_light)
                place, towards = pose[:3, 3], -pose[:3, 2]
                size = light.width, light.height, MARK / 10
                space.add_box(f"{name}/face", colour, size, position=place, wxyz=quaternion(pose))
            case SunLight():
                towards = np.asarray(light.direction)
                place = middle - AWAY * towards
            case PointLight() | SpotLight():
                place, towards = np.asarray(light.position), np.asarray(light.direction)
            case _:
                return
        ends = np.stack([place, place + LONG * towards])[None]
        space.add_arrows(f"{name}/towards", ends, colour, shaft_radius=MARK / 5, head_radius=MARK / 2, head_length=MARK)
        if not isinstance(light, AreaLight):
            space.add_icosphere(f"{name}/bulb", MARK, colour, position=place)
        space.add_label(f"{name}/label", light.name.replace("_", " "), position=place)


def seen_gaussians(record: SceneRecord, views: Sequence[ViewData]) -> SceneGaussians:
    """Make Gaussians of what a scene's views see."""
    geometry = [view.geometry for view in views]
    return gaussians_from_views(
        record.scene.cameras,
        np.stack([each.z_depth for each in geometry]),
        np.stack([each.instance_id for each in geometry]),
        [record.scene.instance_id(name) for name in record.scene.insertable],
        side=SIDE,
        normals=np.stack([each.normal_world for each in geometry]),
    )


def boxes_of(
    record: SceneRecord, views: Sequence[ViewData], found: SceneGaussians
) -> dict[str, tuple[Float64, Float64, Float64]]:
    """Return the box of what is seen of each object: low and high (3,) in its frame, and the frame's pose (4, 4)."""
    ids = np.stack([view.geometry.instance_id.ravel() for view in views])[*found.sources.T]
    boxes = {}
    for body in record.scene.bodies:
        points = found.gaussians.means[ids == record.scene.instance_id(body.name)]
        if body.role == "object" and len(points):
            pose = np.asarray(body.world_from_body)
            inside = (points - pose[:3, 3]) @ np.linalg.inv(pose[:3, :3]).T
            boxes[body.name] = inside.min(axis=0), inside.max(axis=0), pose
    return boxes


def quaternion(pose: ArrayLike) -> Float64:
    """Return the rotation (wxyz) of a matrix of rotation and uniform scale."""
    turn = np.asarray(pose)[:3, :3]
    return np.roll(Rotation.from_matrix(turn / np.cbrt(np.linalg.det(turn))).as_quat(), 1)
