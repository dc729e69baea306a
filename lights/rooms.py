"""The lights of a room: daylight through its windows, its lamps, screens, candles and fires, in photometric ranges.

Daylight is set by the illuminance on the outer face of a window, lamps by the luminous flux of what is sold for the
purpose, scaled so that together they light the floor like a living room; screens and fires by luminance.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lights.balance import scaled
from lights.colour import gel_rgb, random_gel, temperature_to_rgb
from lights.irradiance import map_directions, small_map
from lights.radiometry import area_radiance_from_flux, rgb_from_scalar, spot_intensity_from_flux, watts_from_photometric
from lights.spec import AreaLight, EmissiveLight, EnvironmentLight, Light, LightRig, SpotLight, SunLight
from lights.tonemap import luminance
from scenes.assets.library import AssetLibrary
from scenes.cameras import matrix4
from scenes.frozen import Rgb
from scenes.materials import GLOW
from scenes.rays import body_triangles
from scenes.spec import Body, MeshAsset, SceneSpec
from scenes.streams import Streams

MOST_LIGHTS = 8
DAY_LUX = (200.0, 1200.0)
"""Illuminance on a window from outside by day [lx]: rain clouds to an overcast noon behind trees and houses."""
DUSK_LUX = (15.0, 120.0)
SUN_RATIO = (1.0, 5.0)
"""Illuminance of sunlight, facing it, against that of the sky on the window."""
ROOM_LUX = (80.0, 350.0)
"""Mean illuminance of the floor by lamps [lx]: a cosy to a well-lit room (EN 12464-1 asks 300 for reading)."""
UTILISATION = 0.4
"""Share of the lamps' flux that reaches the floor, directly and by way of walls and ceiling."""
FLUX: dict[str, tuple[float, float]] = {
    "ceilinglamp": (1200.0, 3500.0), "ceiling_lamp": (1200.0, 3500.0), "pendant": (600.0, 1600.0),
    "floorlamp": (600.0, 1600.0), "floor_lamp": (600.0, 1600.0), "tablelamp": (300.0, 800.0),
    "big_table_lamp": (300.0, 800.0), "lamp": (150.0, 600.0), "fireplace": (200.0, 600.0), "candle": (10.0, 20.0),
}  # fmt: skip
"""Luminous flux [lm] by category: household lamps; a candle of 1 cd gives 4 pi lm."""
SCREEN_NITS = (90.0, 350.0)
"""Luminance of screens [cd/m²]."""
SKY_SHARE = 0.15
"""Share of the rooms high above everything, with nothing but sky before the windows."""
_FLAMES = ("flame", "vela")

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class _Glow:
    """A part of a body that may shine: what it is, its area [m²], and whether its removal is rendered."""

    body: Body
    part: int
    kind: str
    area: float


def sample_room_rig(streams: Streams, scene: SceneSpec, library: AssetLibrary) -> LightRig:
    """Draw the lights of a room scene: what is named `GLOW` shines, windows bring daylight or dusk, or none.

    1 to `MOST_LIGHTS` lights. Raises `ValueError` for a scene without windows and without anything that can shine.
    """
    rng = streams("rig")
    glows = _glows(rng, scene, library)
    windows = [body for body in scene.bodies if body.category == "window"]
    if not windows and not glows:
        raise ValueError(f"scene {scene.index} has neither windows nor lamps, so nothing can light it")
    hour = str(rng.choice(["day", "dusk", "night"], p=[0.66, 0.22, 0.12]))
    bright = sum(glow.kind in FLUX and FLUX[glow.kind][1] > 500 for glow in glows)
    if bright < 2:
        hour = "day"
    rig: list[Light] = []
    if windows and hour != "night":
        sky_lux = _log_uniform(rng, *(DAY_LUX if hour == "day" else DUSK_LUX))
        rig.append(_daylight(rng, windows, library, sky_lux))
        if hour == "day" and rng.random() < 0.5:
            rig.append(_sun(rng, windows, sky_lux))
    lamps: list[Light] = [_shining(rng, glow) for glow in glows[: MOST_LIGHTS - 3]]
    extra = _downlight(rng, scene)
    flux = sum(_flux(light, glows) for light in lamps)
    lux = _log_uniform(rng, *ROOM_LUX)
    wanted = lux * _floor_area(scene, library) / UTILISATION
    factor = float(np.clip(wanted / max(flux, 1.0), 0.5, 2.5))
    screens = {glow.body.name for glow in glows if glow.kind in ("screen", "candle")}
    rig += [light if light.name in screens else scaled(light, factor) for light in lamps]
    rig += [extra] if extra is not None else []
    return LightRig(lights=tuple(rig))


def _glows(rng: np.random.Generator, scene: SceneSpec, library: AssetLibrary) -> list[_Glow]:
    """List what may shine: inserted bodies first, then the others in a random order, one part a body."""
    found = []
    for i in rng.permutation(len(scene.bodies)):
        body = scene.bodies[int(i)]
        for part, material in enumerate(body.materials):
            if material.name == GLOW and isinstance(body.geometry, MeshAsset):
                name = library.mesh(body.geometry.asset).parts[part].name
                area = float(np.linalg.norm(_crosses(body, part, library), axis=1).sum() / 2)
                found.append(_Glow(body, part, _kind(body, name), area))
                break
    return sorted(found, key=lambda glow: (not glow.body.insertable, -FLUX.get(glow.kind, (0.0, 100.0))[1]))


def _kind(body: Body, part: str) -> str:
    """Name what sort of light a part gives."""
    if part in _FLAMES:
        return "candle"
    return body.category if body.category in FLUX else "screen"


def _crosses(body: Body, part: int, library: AssetLibrary) -> Float64:
    """Return the cross products of two edges of each triangle of a part, in the world, (F, 3) [m²]."""
    vertices, faces = body_triangles(body, library)
    assert isinstance(body.geometry, MeshAsset)
    sizes = [len(p.faces) for p in library.mesh(body.geometry.asset).parts]
    first = sum(sizes[:part])
    a, b, c = np.moveaxis(vertices[faces[first : first + sizes[part]]], 1, 0)
    return np.asarray(np.cross(b - a, c - a))


def _shining(rng: np.random.Generator, glow: _Glow) -> EmissiveLight:
    """Let a part shine: lamps warm mostly, screens like daylight, a few lamps through a gel."""
    if glow.kind == "screen":
        temperature, strength = float(rng.uniform(6000.0, 8000.0)), _log_uniform(rng, *SCREEN_NITS)
        radiance = watts_from_photometric(strength)
    else:
        low = 1800.0 if glow.kind in ("candle", "fireplace") else 2500.0
        temperature = float(np.clip(np.exp(rng.normal(np.log(low * 1.4), 0.22)), low, 6500.0))
        flux = watts_from_photometric(_log_uniform(rng, *FLUX[glow.kind]))
        radiance = area_radiance_from_flux(flux, glow.area)
    gel: str | None = None
    colour = temperature_to_rgb(round(temperature))
    if glow.kind not in ("candle", "fireplace") and rng.random() < 0.08:
        gel = random_gel(rng)
        tint = gel_rgb(gel, float(rng.uniform(0.4, 0.9)))
        colour = (colour[0] * tint[0], colour[1] * tint[1], colour[2] * tint[2])
    return EmissiveLight(
        name=glow.body.name,
        colour_temperature=round(temperature),
        gel=gel,
        body=glow.body.name,
        part=glow.part,
        radiance=rgb_from_scalar(radiance, colour),
    )


def _flux(light: Light, glows: list[_Glow]) -> float:
    """Return the luminous flux of a shining part [lm], 0 for screens and candles."""
    assert isinstance(light, EmissiveLight)
    glow = next(glow for glow in glows if glow.body.name == light.body)
    if glow.kind in ("screen", "candle"):
        return 0.0
    return _grey(light.radiance) * np.pi * glow.area / watts_from_photometric(1.0)


def _floor_area(scene: SceneSpec, library: AssetLibrary) -> float:
    """Return the floor's area [m²], from the walls' extent in the room's own axes."""
    walls = [body for body in scene.bodies if body.category == "skirting"]
    corners = np.concatenate([body_triangles(body, library)[0] for body in walls])
    axes = np.array(walls[0].world_from_body)[:2, :2]
    span = np.ptp(corners[:, :2] @ np.column_stack([axes[:, 0], [-axes[1, 0], axes[0, 0]]]), axis=0)
    return float(np.prod(span))


def _daylight(rng: np.random.Generator, windows: list[Body], library: AssetLibrary, lux: float) -> EnvironmentLight:
    """Draw what is outside: an outdoor map turned so that its bright side is before a window, scaled to `lux`."""
    outward = _outward(windows[int(rng.integers(len(windows)))])
    wanted = watts_from_photometric(lux)
    wanted_kind = "sky" if rng.random() < SKY_SHARE else "outdoor"
    found = [info for info in library.list("environment") if info.category in ("outdoor", "sky")]
    maps = [info for info in found if info.category == wanted_kind] or found
    if not maps:
        temperature = round(float(rng.uniform(5500.0, 9000.0)))
        # A uniform sphere of radiance L gives pi L.
        colour = rgb_from_scalar(wanted / np.pi, temperature_to_rgb(temperature))
        return EnvironmentLight(name="environment", colour_temperature=temperature, radiance=colour)
    info = maps[int(rng.integers(len(maps)))]
    image = luminance(small_map(library, info.id))
    directions, solid_angle = map_directions(0.0)
    mean = ((image * solid_angle[:, None])[..., None] ** 1.2 * directions).sum(axis=(0, 1))
    azimuth = float(np.arctan2(outward[1], outward[0])) + float(rng.uniform(-1.3, 1.3))
    rotation = (azimuth - float(np.arctan2(mean[1], mean[0]))) % (2 * np.pi)
    directions, _ = map_directions(rotation)
    cosine = np.maximum(directions @ outward, 0.0)
    unit = float((image * solid_angle[:, None] * cosine).sum())
    factor = wanted / max(unit, 1e-9)
    return EnvironmentLight(name="environment", map=info.id, rotation=rotation, radiance=(factor, factor, factor))


def _outward(window: Body) -> Float64:
    """Return the way out of a window (3,): assets face the room with -Y."""
    pose = np.array(window.world_from_body)
    return np.asarray(pose[:3, 1] / np.linalg.norm(pose[:3, 1]))


def _sun(rng: np.random.Generator, windows: list[Body], sky_lux: float) -> SunLight:
    """Let the sun in at a window, from the side and low enough to reach into the room."""
    outward = _outward(windows[int(rng.integers(len(windows)))])
    azimuth = float(np.arctan2(outward[1], outward[0])) + float(rng.uniform(-1.0, 1.0))
    elevation = float(np.radians(rng.uniform(14.0, 50.0)))
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    temperature = round(float(np.interp(elevation, [0.25, 0.9], [3300.0, 5600.0]) * rng.uniform(0.95, 1.05)))
    strength = watts_from_photometric(sky_lux * _log_uniform(rng, *SUN_RATIO))
    angle = 0.00918 if rng.random() < 0.6 else _log_uniform(rng, 0.00918, 0.05)
    return SunLight(
        name="sun",
        colour_temperature=temperature,
        direction=(float(-towards[0]), float(-towards[1]), float(-towards[2])),
        irradiance=rgb_from_scalar(strength, temperature_to_rgb(temperature)),
        angle=angle,
    )


def _downlight(rng: np.random.Generator, scene: SceneSpec) -> SpotLight | AreaLight | None:
    """Let a recessed spot or a flat panel in the ceiling shine down near what is inserted, in a third of the rooms."""
    chance = rng.random()
    if chance > 0.35:
        return None
    places = np.array([np.array(body.world_from_body)[:3, 3] for body in scene.bodies if body.insertable])
    ceiling = next(body for body in scene.bodies if body.category == "ceiling")
    height = float(np.array(ceiling.world_from_body)[2, 3])
    place = np.array([*(places.mean(axis=0)[:2] + rng.uniform(-0.4, 0.4, 2)), height - 0.01])
    temperature = round(float(rng.uniform(2700.0, 4500.0)))
    colour = temperature_to_rgb(temperature)
    if chance < 0.2:
        half = float(np.radians(rng.uniform(16.0, 38.0)))
        flux = watts_from_photometric(_log_uniform(rng, 250.0, 700.0))
        return SpotLight(
            name="downlight",
            colour_temperature=temperature,
            position=(float(place[0]), float(place[1]), float(place[2])),
            direction=(0.0, 0.0, -1.0),
            intensity=rgb_from_scalar(spot_intensity_from_flux(flux, half), colour),
            half_angle=half,
            blend=float(rng.uniform(0.2, 0.7)),
            radius=0.03,
        )
    side = float(rng.uniform(0.2, 0.6))
    pose = np.eye(4)
    pose[:3, 3] = place
    flux = watts_from_photometric(_log_uniform(rng, 700.0, 2500.0))
    return AreaLight(
        name="panel",
        colour_temperature=temperature,
        width=side,
        height=side,
        world_from_light=matrix4(pose),
        radiance=rgb_from_scalar(area_radiance_from_flux(flux, side * side), colour),
    )


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw between two positive numbers, evenly in their logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _grey(colour: Rgb) -> float:
    """Return the luminance of one RGB value."""
    return float(luminance(np.array(colour)))
