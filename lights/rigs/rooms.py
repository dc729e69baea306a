"""The lights of a room: daylight through its windows, its lamps, screens, candles and fires, in photometric ranges.

Daylight is set by the illuminance on the outer face of a window, lamps by the luminous flux of what is sold for the
purpose, scaled so that together they light the floor like a living room; screens and fires by luminance.
"""

from dataclasses import dataclass

import numpy as np

from multilight.lights.photometry.colour import gel_rgb, random_gel, temperature_to_rgb
from multilight.lights.photometry.radiometry import (
    area_radiance_from_flux,
    rgb_from_scalar,
    spot_solid_angle,
    watts_from_photometric,
)
from multilight.lights.rigs.design import rig_design
from multilight.lights.rigs.windows import daylight, sunlight
from multilight.lights.spec import AreaLight, EmissiveLight, Light, LightRig, SpotLight
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.frozen import triple
from multilight.scenes.geometry.rays import body_triangles, part_triangles
from multilight.scenes.materials import GLOW
from multilight.scenes.materials.emission import sample_glow
from multilight.scenes.meshes import triangle_areas
from multilight.scenes.poses import matrix4, translation
from multilight.scenes.random_streams import Rng, Streams, log_uniform, weighted_pick
from multilight.scenes.spec import Body, MeshAsset, SceneSpec, Texture

MOST_LIGHTS = 8
DAY_LUX = (200.0, 1200.0)
"""Illuminance on a window from outside by day [lx]: rain clouds to an overcast noon behind trees and houses."""
DUSK_LUX = (15.0, 120.0)
ROOM_LUX = (80.0, 350.0)
"""Mean illuminance of the floor by lamps [lx]: a cosy to a well-lit room (EN 12464-1 asks 300 for reading)."""
UTILISATION = 0.4
"""Fraction of the lamps' flux that reaches the floor, directly and from walls and ceiling."""
FLUX: dict[str, tuple[float, float]] = {
    "ceilinglamp": (1200.0, 3500.0), "ceiling_lamp": (1200.0, 3500.0), "pendant": (600.0, 1600.0),
    "floorlamp": (600.0, 1600.0), "floor_lamp": (600.0, 1600.0), "tablelamp": (300.0, 800.0),
    "big_table_lamp": (300.0, 800.0), "lamp": (150.0, 600.0), "fireplace": (200.0, 600.0), "candle": (10.0, 20.0),
}  # fmt: skip
"""Luminous flux [lm] by category: household lamps; a candle of 1 cd gives 4 pi lm."""
STRONGER = (0.5, 2.5)
"""How far lamps may depart from the flux that was drawn: with dimmers and in pairs."""
HOURS = {"day": 0.66, "dusk": 0.22, "night": 0.12}
"""Probabilities of what the windows bring."""
SUNNY, RECESSED = 0.6, 0.35
"""Probabilities that the sun comes in by day, and that a light is let into the ceiling."""
DOWNLIGHT_LUMENS, PANEL_LUMENS = (250.0, 700.0), (700.0, 2500.0)
"""Luminous flux of recessed spots, and of flat panels of 20 to 60 cm [lm]."""
GELS = 0.05
"""Fraction of a room's own lamps that shine in a saturated colour."""
SCREEN_NITS = (90.0, 350.0)
"""Luminance of screens [cd/m²]."""
_FLAMES = ("flame", "vela")


@dataclass(frozen=True)
class _Glow:
    """A part of a body that may shine: what it is, its area [m²], and whether its removal is rendered."""

    body: Body
    part: int
    kind: str
    area: float

    @property
    def bright(self) -> bool:
        """Whether it can light a room."""
        return FLUX.get(self.kind, (0.0, 0.0))[1] > 500


def room_rig(
    streams: Streams, scene: SceneSpec, library: AssetLibrary, *, lights: tuple[int, int] = (1, MOST_LIGHTS)
) -> LightRig:
    """Draw the lights of a room scene: what is named `GLOW` shines, windows bring daylight or dusk, or none.

    `lights` (fewest, most): what glows among the inserted objects comes first, then daylight or the brightest lamp,
    then others of the room's own; recessed downlights make up what the room lacks. Raises `ValueError` for a scene
    without windows and without anything that can shine.
    """
    rng = streams("rig")
    glows = _glows(rng, scene, library)
    windows = [body for body in scene.bodies if body.category == "window"]
    if not windows and not glows:
        raise ValueError(f"scene {scene.index} has neither windows nor lamps, so nothing can light it")
    hour = weighted_pick(rng, HOURS)
    if sum(glow.bright for glow in glows) < 2 or not windows:
        hour = "day" if windows else "night"
    inserted = sum(glow.body.insertable for glow in glows)
    count = min(max(rig_design(streams).lights, 1 + inserted, lights[0]), lights[1])
    day: list[Light] = []
    if hour != "night":
        sky_lux = log_uniform(rng, *(DAY_LUX if hour == "day" else DUSK_LUX))
        day.append(daylight(rng, windows, library, sky_lux))
        if hour == "day" and rng.random() < SUNNY:
            day.append(sunlight(rng, windows, sky_lux))
    # By night the brightest lamp is what daylight is by day: always on.
    first = min(inserted + (not day), len(glows))
    optional: list[Light | _Glow] = [*day[1:], *glows[first:]]
    optional = [optional[int(i)] for i in rng.permutation(len(optional))]
    chosen = [*glows[:first], *day[:1], *optional][:count]
    # As many recessed lights as are lacking, or one, if there is room for it.
    wanted = max(lights[0] - len(chosen), int(rng.random() < RECESSED))
    numbers = range(min(wanted, max(count - len(chosen), 0)))
    spots = [_downlight(rng, scene, "" if number == 0 else f"_{number + 1}") for number in numbers]
    shining = [(glow, _shining(rng, glow, library)) for glow in chosen if isinstance(glow, _Glow)]
    lamps = _scaled_to(log_uniform(rng, *ROOM_LUX) * _floor_area(scene, library), shining)
    return LightRig(lights=(*(light for light in chosen if not isinstance(light, _Glow)), *lamps, *spots))


def _scaled_to(wanted: float, shining: list[tuple[_Glow, EmissiveLight]]) -> list[Light]:
    """Make lamps as strong as a room asks that wants `wanted` lumens on its floor, within what is sold."""
    lamps = [light.grey * np.pi * glow.area / watts_from_photometric(1.0) for glow, light in shining if glow.bright]
    factor = float(np.clip(wanted / UTILISATION / max(sum(lamps), 1.0), *STRONGER))
    return [light.scaled(factor) if glow.bright else light for glow, light in shining]


def _glows(rng: Rng, scene: SceneSpec, library: AssetLibrary) -> list[_Glow]:
    """List what may shine: inserted bodies first, then the others in a random order, one part a body."""
    found = []
    for i in rng.permutation(len(scene.bodies)):
        body = scene.bodies[int(i)]
        for part, material in enumerate(body.materials):
            if material.name == GLOW and isinstance(body.geometry, MeshAsset):
                name = library.mesh(body.geometry.asset).parts[part].name
                area = triangle_areas(part_triangles(body, part, library)).sum()
                found.append(_Glow(body, part, _kind(body, name), float(area)))
                break
    return sorted(found, key=lambda glow: (not glow.body.insertable, -FLUX.get(glow.kind, (0.0, 100.0))[1]))


def _kind(body: Body, part: str) -> str:
    """Name what sort of light a part gives."""
    if part in _FLAMES:
        return "candle"
    return body.category if body.category in FLUX else "screen"


def _shining(rng: Rng, glow: _Glow, library: AssetLibrary) -> EmissiveLight:
    """Let a part shine: objects as such things do (`materials.emission`), screens like daylight, lamps warm mostly."""
    assert isinstance(glow.body.geometry, MeshAsset)
    info = library.info(glow.body.geometry.asset)
    texture: Texture | None = None
    if glow.body.role == "object":
        scale = float(np.cbrt(np.linalg.det(np.array(glow.body.world_from_body)[:3, :3])))
        found = sample_glow(rng, library, info, glow.part, scale=scale)
        temperature, coloured, texture = found.kelvin, found.coloured, found.texture
        radiance = watts_from_photometric(found.nits)
    elif glow.kind == "screen":
        texture = library.mesh(info.id).parts[glow.part].material.base_color_texture
        temperature, coloured = float(rng.uniform(6000.0, 8000.0)), False
        radiance = watts_from_photometric(log_uniform(rng, *SCREEN_NITS))
    else:
        low, usual = (1800.0, 2000.0) if glow.kind == "fireplace" else (2500.0, 3800.0)
        temperature = float(np.clip(np.exp(rng.normal(np.log(usual), 0.2)), low, 6500.0))
        coloured = glow.kind != "fireplace" and rng.random() < GELS
        radiance = area_radiance_from_flux(watts_from_photometric(log_uniform(rng, *FLUX[glow.kind])), glow.area)
    gel = random_gel(rng) if coloured else None
    colour = temperature_to_rgb(round(temperature))
    if gel is not None:
        tint = gel_rgb(gel, float(rng.uniform(0.4, 0.9)))
        colour = triple(a * b for a, b in zip(colour, tint, strict=True))
    return EmissiveLight(
        name=glow.body.name,
        colour_temperature=round(temperature),
        gel=gel,
        body=glow.body.name,
        part=glow.part,
        radiance=rgb_from_scalar(radiance, colour),
        texture=texture,
    )


def _floor_area(scene: SceneSpec, library: AssetLibrary) -> float:
    """Return the floor's area [m²], from the walls' extent in the room's own axes."""
    walls = [body for body in scene.bodies if body.category == "skirting"]
    corners = np.concatenate([body_triangles(body, library)[0] for body in walls])
    axes = np.array(walls[0].world_from_body)[:2, :2]
    span = np.ptp(corners[:, :2] @ np.column_stack([axes[:, 0], [-axes[1, 0], axes[0, 0]]]), axis=0)
    return float(np.prod(span))


def _downlight(rng: Rng, scene: SceneSpec, suffix: str) -> SpotLight | AreaLight:
    """Let a recessed spot or a flat panel shine down between what is inserted and the centre of the room."""
    places = np.array([np.array(body.world_from_body)[:3, 3] for body in scene.bodies if body.insertable])
    ceiling = next(body for body in scene.bodies if body.category == "ceiling")
    centre = np.array(ceiling.world_from_body)[:3, 3]
    inwards = float(rng.uniform(0.1, 0.5) if not suffix else rng.uniform(0.2, 1.2))
    flat = (1 - inwards) * places.mean(axis=0)[:2] + inwards * centre[:2] + rng.uniform(-0.2, 0.2, 2)
    place = np.array([*flat, centre[2] - 0.01])
    temperature = round(float(rng.uniform(2900.0, 5500.0)))
    colour = temperature_to_rgb(temperature)
    if rng.random() < 0.6:
        half = float(np.radians(rng.uniform(16.0, 38.0)))
        flux = watts_from_photometric(log_uniform(rng, *DOWNLIGHT_LUMENS))
        return SpotLight(
            name=f"downlight{suffix}",
            colour_temperature=temperature,
            position=triple(place),
            direction=(0.0, 0.0, -1.0),
            intensity=rgb_from_scalar(flux / spot_solid_angle(half), colour),
            half_angle=half,
            blend=float(rng.uniform(0.2, 0.7)),
            radius=0.03,
        )
    side = float(rng.uniform(0.2, 0.6))
    flux = watts_from_photometric(log_uniform(rng, *PANEL_LUMENS))
    return AreaLight(
        name=f"panel{suffix}",
        colour_temperature=temperature,
        width=side,
        height=side,
        world_from_light=matrix4(translation(place)),
        radiance=rgb_from_scalar(area_radiance_from_flux(flux, side * side), colour),
    )
