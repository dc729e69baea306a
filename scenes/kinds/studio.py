"""Studio scenes: wares before a photographer's seamless backdrop, on its floor, on a product table, on plinths."""

from dataclasses import replace
from typing import Literal

import numpy as np

from multilight.scenes.assets.builtin.backdrops import ROLL, ROLL_ID, STUDIO, SWEEP_ID, TABLE_SWEEP_IDS, table_size
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.colour import linear_from_hex
from multilight.scenes.materials import painted_wall, sample_material
from multilight.scenes.poses import translation
from multilight.scenes.random_streams import Rng, Streams, pick, weighted_pick
from multilight.scenes.spec import Body, Material, SceneSpec
from multilight.scenes.still_life.planes import downward_pose, plane, upright_pose
from multilight.scenes.still_life.receivers import choose_receiver, with_receiver
from multilight.scenes.still_life.sample import StillLifeSettings, sample_still_life
from multilight.scenes.still_life.setting import Setting, flat_surface, make_body

StudioKind = Literal["cyclorama", "roll", "table"]
PROBABILITIES: dict[StudioKind, float] = {"cyclorama": 0.3, "roll": 0.3, "table": 0.4}
"""How often the backdrop is a wide cove, a paper roll on a stand, a product table."""
LENS_MM = (35.0, 85.0)
# Measures of studios [m, rad], and how often they have what [probability].
PLINTHS, RAISED = 0.45, (0.3, 0.8)  # scenes with plinths; fraction of their objects that stand on one
MOST = 6  # objects: a set of wares, not a crowd
WALL_HEIGHT, ROOM = 4.3, 12.0  # height and depth of the studio
ASIDE, ASIDE_CLOSED = (3.0, 5.0), 5.5  # side walls to the midline: clear of cameras, and where a mirror shows them
BEFORE_BEND = 0.3  # wares to the bend of a sweep, so that their shadows fall on paper
BEFORE_SWEEP, BEFORE_TABLE = 0.6, 0.55  # half the angle in which there is paper behind the wares
LIFT = 0.0003  # air below the paper, so that no two surfaces coincide
_PAPERS = (
    "f6f5f2", "f6f5f2", "e4e2de", "b9bbbd", "7d7f82", "4a4b4e", "2b2b2d", "e6d8c4", "c9d5d0", "7fa0ad", "d8aea4",
    "97a289", "ecd6a6", "b5402f", "1f4e79", "e0a32e", "2f6b4f", "6a4a7d",
)  # fmt: skip


def sample_studio(streams: Streams, library: AssetLibrary, *, index: int, settings: StillLifeSettings) -> SceneSpec:
    """Draw a studio scene: three to six objects, cameras of 35 to 85 mm (within the configured lenses).

    The same streams, assets and settings give the same scene anywhere. Raises `SceneSamplingError` where no attempt
    succeeds.
    """
    place = streams("place")
    kind = weighted_pick(place, PROBABILITIES)
    receiver = choose_receiver(place, loose=True)
    raised = float(place.uniform(*RAISED)) if place.random() < PLINTHS and receiver == "none" else 0.0

    def build(attempt: int) -> Setting:
        rng = streams(f"studio/{attempt}")
        closed = receiver != "none"
        setting = _table(rng, library, closed) if kind == "table" else _floor(rng, library, kind == "roll", closed)
        setting = replace(setting, raised=raised)
        return with_receiver(streams(f"receiver/{attempt}"), library, setting, receiver)

    low, high = (float(np.clip(lens, *LENS_MM)) for lens in settings.cameras.lens_mm)
    cameras = settings.cameras.model_copy(update={"lens_mm": (low, high)})
    settings = settings.model_copy(update={"cameras": cameras})
    return sample_still_life(streams, library, build, kind="studio", index=index, settings=settings)


def _paper(rng: Rng) -> Material:
    """Draw a backdrop: paper mostly, sometimes painted cove or vinyl with a sheen."""
    colour = linear_from_hex(str(rng.choice(_PAPERS)))
    finish = "paper" if rng.random() < 0.75 else "paint"
    return sample_material(rng, finish, colour=colour, name="paper")


def _room(rng: Rng, behind: float, closed: bool) -> list[Body]:
    """Build the studio itself: a floor, dim walls behind and on one side, `behind` [m] from the centre.

    Where something mirrors, the other walls and the ceiling are there too, so that it shows a room, not a void.
    """
    concrete = sample_material(rng, "floor", colour=linear_from_hex(str(rng.choice(("77736c", "54514c", "8d8a85")))))
    wall, side = painted_wall(rng), float(rng.choice([-1.0, 1.0]))
    aside = ASIDE_CLOSED if closed else float(rng.uniform(*ASIDE))
    centre = behind - ROOM / 2
    plan = {"back": ((0.0, behind), (0.0, -1.0), 2 * aside), "side": ((side * aside, centre), (-side, 0.0), ROOM)}
    if closed:
        plan["other_side"] = ((-side * aside, centre), (side, 0.0), ROOM)
        plan["front"] = ((0.0, behind - ROOM), (0.0, 1.0), 2 * aside)
    bodies = [plane("floor", (40.0, 40.0), concrete, np.eye(4))]
    for name, (foot, inward, width) in plan.items():
        pose = upright_pose((*foot, WALL_HEIGHT / 2), inward)
        bodies.append(plane(f"wall_{name}", (width, WALL_HEIGHT), wall, pose))
    if closed:
        white = sample_material(rng, "wall")
        bodies.append(plane("ceiling", (2 * aside, ROOM), white, downward_pose(0.0, centre, WALL_HEIGHT)))
    return bodies


def _floor(rng: Rng, library: AssetLibrary, roll: bool, closed: bool) -> Setting:
    """Set up a sweep on the studio's floor; things stand on the paper."""
    size, asset = (ROLL, ROLL_ID) if roll else (STUDIO, SWEEP_ID)
    mesh = library.mesh(asset)
    pose = translation((0.0, 0.0, LIFT))
    bar = sample_material(rng, "polished", name="bar")
    materials = (_paper(rng), bar)[: len(mesh.parts)]
    body = make_body("backdrop", "surrounding", library.info(asset), mesh, materials, pose)
    room = _room(rng, size.depth / 2 + 0.4, closed)
    # The cove hides the walls of an open studio.
    bodies = room if roll or closed else room[:1]
    depth = min(1.5, 0.6 * (size.depth - size.radius))
    surface = flat_surface(min(2.4, 0.8 * size.width), depth)
    on_paper = translation((0.0, size.depth / 2 - size.radius - BEFORE_BEND - depth / 2, LIFT))
    return Setting((*bodies, body), (), surface, on_paper, -np.pi / 2, BEFORE_SWEEP, most=MOST)


def _table(rng: Rng, library: AssetLibrary, closed: bool) -> Setting:
    """Set up a product table: a small sweep on a frame."""
    asset = pick(rng, TABLE_SWEEP_IDS)
    info, mesh = library.info(asset), library.mesh(asset)
    frame = sample_material(rng, str(rng.choice(("brushed", "paint"))), name="frame")
    body = make_body("backdrop", "support", info, mesh, (_paper(rng), frame), np.eye(4))
    paper = mesh.parts[0].vertices
    low, size = paper.min(axis=0).astype(float), table_size(float(np.ptp(paper[:, 0])))
    # Only before the bend is the paper flat.
    surface = flat_surface(size.width, size.depth - size.radius, cell=0.01)
    on_paper = translation((low[0] + size.width / 2, low[1] + (size.depth - size.radius) / 2, low[2]))
    deep = float(mesh.bounds()[1, 1])
    room = _room(rng, deep + float(rng.uniform(0.3, 1.5)), closed)
    return Setting((*room, body), (), surface, on_paper, -np.pi / 2, BEFORE_TABLE, most=MOST)
