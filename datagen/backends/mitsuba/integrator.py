"""The per-light path integrator: one path, a sum for each light.

Mitsuba's own `path` integrator, except that light is credited to the emitter that it came from. At each vertex
every light is sampled once; hits are weighted against that by the power heuristic (Veach 1997). The result also says
which removable bodies a sample has met, so that a variant without one of them traces only those samples again.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from multilight.datagen.backends.mitsuba import bsdf
from multilight.datagen.backends.mitsuba.arrays import NONE
from multilight.datagen.backends.mitsuba.lights import Lights, Meeting, Sample, glow_density
from multilight.datagen.backends.mitsuba.sampling import Sampler
from multilight.datagen.backends.mitsuba.surfaces import Hit, Surfaces, TriangleSet

SEE_THROUGH_SURFACES = 32
FILTER_GLOSSY = 0.25
"""Cycles' `blur_glossy`: after a diffuse bounce lobes get at least some width, against fireflies."""
SHARP = 10.0
"""Density (1/sr) of directions above which a bounce shows a picture of what it meets: GGX of roughness below 0.3."""
ROULETTE_FROM = 3
LIGHT, LOBE, DIRECTION, ROULETTE, OPACITY = 16, 0, 1, 2, 3


@dataclass
class Found:
    """What a ray meets first: the distance [m], infinite where there is nothing, and where on which triangle."""

    t: mi.Float
    face: mi.UInt32
    uv: mi.Point2f
    valid: mi.Bool


@dataclass
class World:
    """What paths run through: triangles (with or without a body), surfaces, lights.

    `fixed` are the opaque triangles that stay in every variant, `changing` the others that are there, insertable or
    see-through: light that is blocked by the former is blocked whatever is removed. All variants share what takes
    longest to build, the structure over the fixed ones.
    """

    fixed: TriangleSet | None
    changing: TriangleSet | None
    surfaces: Surfaces
    lights: Lights
    tables: bsdf.Tables
    bits: mi.UInt32
    """By body number: the bit of a removable body, else 0."""

    def nearest(self, ray: mi.Ray3f, active: mi.Bool, *, coherent: mi.Bool | bool = False) -> Found:
        """Find the first triangle that a ray meets."""
        found = Found(mi.Float(dr.inf), mi.UInt32(0), mi.Point2f(0), mi.Bool(False))
        for triangles in (self.fixed, self.changing):
            if triangles is not None:
                nearer = mi.Ray3f(ray.o, ray.d, found.t, 0.0, mi.Color0f())
                pi = triangles.scene.ray_intersect_preliminary(nearer, coherent=coherent, active=active)
                hit = active & pi.is_valid()
                found.t = dr.select(hit, pi.t, found.t)
                found.face = dr.select(hit, triangles.face(pi, hit), found.face)
                found.uv = dr.select(hit, pi.prim_uv, found.uv)
                found.valid |= hit
        return found


@dataclass
class PathResult:
    """Which removable bodies one sample met, and what it saw first."""

    met: mi.UInt32
    first: mi.UInt32
    """The body seen first, 0 where there was none."""
    covered: mi.Bool
    """Some surface was there, see-through or not."""
    steps: mi.UInt32
    """How often a ray was followed."""
    seen: mi.UInt32
    """Of the removable bodies that were met, those that the path saw: straight, in mirrors or through glass."""


class Planes:
    """What samples bring, plane after plane, a number for each sample: three planes for each light's colour, then three
    for the albedo and three for the normal of what they saw first."""

    GUIDES = 6

    def __init__(self, lights: int, samples: int) -> None:
        self.count = 3 * lights + self.GUIDES
        self._width = samples
        self.samples = dr.opaque(mi.UInt32, samples)
        self.values = dr.zeros(mi.Float, self.count * samples)
        self._sample = dr.arange(mi.UInt32, samples)
        self._guides = dr.opaque(mi.UInt32, 3 * lights)

    def places(self, planes: int) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32]:
        """Return plane, sample and place in `values` of all numbers of the first so many planes."""
        place = dr.arange(mi.UInt32, planes * self._width)
        plane = place // self.samples
        return plane, place - plane * self.samples, place

    def add(self, light: mi.UInt32, colour: mi.Color3f, active: mi.Bool) -> None:
        """Add to a light's colour."""
        for channel in range(3):
            place = (light * 3 + channel) * self.samples + self._sample
            dr.scatter_add(self.values, colour[channel], place, active, mode=dr.ReduceMode.NoConflicts)

    def see(self, albedo: mi.Color3f, normal: mi.Normal3f, active: mi.Bool) -> None:
        """Set the guides."""
        for channel, value in enumerate((*albedo, *normal)):
            dr.scatter(self.values, value, (self._guides + channel) * self.samples + self._sample, active)


@dataclass
class PathState:
    """A path on its way, a lane each: the ray `o`, `d` to follow, and what came before it."""

    active: mi.Bool
    o: mi.Point3f
    d: mi.Vector3f
    depth: mi.UInt32
    """Bounces so far."""
    passes: mi.UInt32
    """See-through surfaces passed so far."""
    travelled: mi.Float
    """Distance from `origin` to `o` [m], which differ after see-through surfaces."""
    throughput: mi.Color3f
    pdf: mi.Float
    """Density [1/sr] with which the last bounce's direction was sampled."""
    least_pdf: mi.Float
    """The least of all bounces."""
    origin: mi.Point3f
    """Where the last bounce was, or the camera."""
    sampler: Sampler
    result: PathResult


def _weight(a: mi.Float, b: mi.Float) -> mi.Float:
    """Power heuristic."""
    a2 = a * a
    return dr.select(a2 > 0, a2 / (a2 + b * b), 0)


def _start(p: mi.Point3f, ng: mi.Normal3f, d: mi.Vector3f) -> mi.Point3f:
    """Move a ray's start off its surface."""
    reach = (1 + dr.max(dr.abs(p))) * mi.Float(dr.epsilon(mi.Float) * 1500)
    return mi.Point3f(p + ng * dr.mulsign(reach, dr.dot(ng, d)))


def _blocked(world: World, hit: Hit, found: Sample, active: mi.Bool) -> tuple[mi.Float, mi.UInt32]:
    """Return the fraction of light that gets through, and the removable bodies that stand in its way."""
    o = _start(hit.p, hit.ng, found.d)
    offset = hit.p + found.d * found.distance - o
    distance = dr.norm(offset)
    ray = mi.Ray3f(o, offset / distance, distance * (1 - dr.epsilon(mi.Float) * 15000), 0.0, mi.Color0f())
    free = mi.Bool(active)
    if world.fixed is not None:
        free &= ~world.fixed.scene.ray_test(ray, active=active)
    if world.changing is None:
        return dr.select(free, mi.Float(1), 0), mi.UInt32(0)
    if world.surfaces.see_through:
        return _dimmed(world, world.changing, ray, free)
    first = world.changing.scene.ray_intersect_preliminary(ray, active=free)
    stopped = free & first.is_valid()
    body = world.surfaces.body(world.changing.face(first, stopped), stopped)
    met = dr.select(stopped, dr.gather(mi.UInt32, world.bits, body, stopped), 0)
    return dr.select(free & ~stopped, mi.Float(1), 0), met


def _dimmed(world: World, changing: TriangleSet, ray: mi.Ray3f, active: mi.Bool) -> tuple[mi.Float, mi.UInt32]:
    """`_blocked` by triangles that may be see-through: each lets a fraction pass."""

    def step(active, o, left, passed, met, count):  # type: ignore[no-untyped-def]
        found = changing.scene.ray_intersect_preliminary(mi.Ray3f(o, ray.d, left, 0.0, mi.Color0f()), active=active)
        hit = active & found.is_valid()
        face = changing.face(found, hit)
        body = world.surfaces.body(face, hit)
        met |= dr.select(hit, dr.gather(mi.UInt32, world.bits, body, hit), 0)
        passed *= dr.select(hit, 1 - world.surfaces.opacity(face, found.prim_uv, hit), 1)
        beyond = found.t * (1 + 1e-5) + 1e-5
        o = dr.select(hit, o + ray.d * beyond, o)
        left = dr.select(hit, left - beyond, left)
        count += 1
        return hit & (passed > 0) & (left > 0) & (count < SEE_THROUGH_SURFACES), o, left, passed, met, count

    passed = dr.select(active, mi.Float(1), 0)
    state = (mi.Bool(active), mi.Point3f(ray.o), mi.Float(ray.maxt), passed, mi.UInt32(0), mi.UInt32(0))
    state = dr.while_loop(state, lambda *s: s[0], step, label="shadow")
    return state[3], state[4]


def trace(world: World, ray: mi.Ray3f, sampler: Sampler, *, max_bounces: int) -> tuple[Planes, PathResult]:
    """Trace one path a lane; radiance is that of its first point, as seen along the ray.

    Lights but the environment and glowing bodies are invisible to the ray itself, and block nothing.
    """
    planes = Planes(world.lights.count, dr.width(ray))
    state = PathState(
        active=mi.Bool(True),
        o=mi.Point3f(ray.o),
        d=mi.Vector3f(ray.d),
        depth=mi.UInt32(0),
        passes=mi.UInt32(0),
        travelled=mi.Float(0),
        throughput=mi.Color3f(1),
        pdf=mi.Float(0),
        least_pdf=mi.Float(dr.inf),
        origin=mi.Point3f(ray.o),
        sampler=sampler,
        result=PathResult(
            met=mi.UInt32(0), first=mi.UInt32(0), covered=mi.Bool(False), steps=mi.UInt32(0), seen=mi.UInt32(0)
        ),
    )

    def step(path: PathState) -> tuple[PathState]:
        _vertex(world, planes, path, max_bounces)
        return (path,)

    (state,) = dr.while_loop((state,), lambda path: path.active, step, label="paths")
    return planes, state.result


def _vertex(world: World, planes: Planes, path: PathState, max_bounces: int) -> None:
    """Follow the ray to what it meets, credit the light found there, and go on from there, or end."""
    depth, result = path.depth, path.result
    ray = mi.Ray3f(path.o, path.d)
    nearest = world.nearest(ray, path.active, coherent=depth == 0)
    found = nearest.valid
    result.steps += dr.select(path.active, mi.UInt32(1), 0)
    hit = world.surfaces.hit(nearest.face, nearest.uv, ray, found)
    bit = dr.select(found, dr.gather(mi.UInt32, world.bits, hit.body, found), 0)
    result.met |= bit
    result.seen |= dr.select(path.least_pdf > SHARP, bit, 0)
    distance = path.travelled + nearest.t
    solid = mi.Bool(found)
    if world.surfaces.see_through:
        solid &= path.sampler.next_1d(OPACITY, depth + path.passes * 64) < hit.opacity
    first = depth == 0
    seen = first & solid
    result.first = dr.select(seen, hit.body, result.first)
    result.covered |= first & found
    planes.see(hit.base, hit.ns, seen)
    _emission(world, planes, path, hit, distance, solid, found)
    on = solid & (depth <= max_bounces)
    frame = mi.Frame3f(hit.ns)
    least = 4 if FILTER_GLOSSY == 0 else path.least_pdf / FILTER_GLOSSY
    blur = dr.select(least < 1, dr.sqrt(dr.maximum(1 - least, 0)) * 0.5, 0)
    c = bsdf.closure(world.tables, hit, frame.to_local(-path.d), blur, glass=world.surfaces.glass)
    _direct(world, planes, path, hit, c, frame, on)
    _bounce(path, hit, c, frame, on)
    if world.surfaces.see_through:
        passing = found & ~solid & (path.passes < SEE_THROUGH_SURFACES)
        path.o = dr.select(passing, mi.Point3f(_start(hit.p, hit.ng, path.d)), path.o)
        path.passes = dr.select(passing, path.passes + 1, path.passes)
        path.travelled = dr.select(passing, distance, path.travelled)
        path.active |= passing


def _emission(
    world: World, planes: Planes, path: PathState, hit: Hit, distance: mi.Float, solid: mi.Bool, found: mi.Bool
) -> None:
    """Credit what the ray itself meets: environments, a glowing surface and, after a bounce, lamps.

    `solid`: whether there is an opaque surface; `found`: whether there is any.
    """
    lights, first = world.lights, path.depth == 0

    def credit(number: mi.UInt32, radiance: mi.Color3f, pdf: mi.Float, there: mi.Bool) -> None:
        weight = dr.select(first, 1, _weight(path.pdf, pdf))
        planes.add(number, path.throughput * radiance * weight, there)

    for sky in lights.environments:
        beyond = sky.met(path.d)
        credit(sky.number, beyond.radiance, beyond.pdf, path.active & ~found)
    glows = solid & (hit.glow != NONE)

    def shining(_: Meeting) -> Meeting:
        row = lights.row(hit.glow, glows)
        pdf = glow_density(row, dr.dot(hit.ng, path.d), dr.norm(hit.p - path.origin))
        return Meeting(mi.Float(0), mi.Color3f(row["colour"]) * world.surfaces.glow_texture(hit, glows), pdf)

    nothing = Meeting(mi.Float(0), mi.Color3f(0), mi.Float(0))
    glow = dr.if_stmt((nothing,), glows, shining, lambda nothing: nothing)
    credit(hit.glow, glow.radiance, glow.pdf, glows)
    bounced = path.active & ~first

    def step(place: mi.UInt32) -> tuple[mi.UInt32]:
        number = lights.lamp(place, bounced)
        lamp = lights.met(number, path.origin, path.d, bounced)
        nearer = (lamp.distance > path.travelled) & (lamp.distance < distance)
        credit(number, lamp.radiance, lamp.pdf, bounced & (lamp.pdf > 0) & nearer)
        return (place + 1,)

    dr.while_loop((mi.UInt32(0),), lambda place: bounced & (place < lights.lamps), step, label="lamps")


def _direct(
    world: World, planes: Planes, path: PathState, hit: Hit, c: bsdf.Closure, frame: mi.Frame3f, on: mi.Bool
) -> None:
    """Sample every light."""

    def step(number: mi.UInt32, met: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        row = world.lights.row(number, on)
        found = world.lights.sample(number, hit.p, path.sampler.next_2d(number + LIGHT, path.depth), on)
        value, pdf = bsdf.evaluate(c, frame.to_local(found.d))
        weight = dr.select(row["delta"] != 0, 1, _weight(found.pdf, pdf))
        light_in = path.throughput * value * found.weight * weight
        usable, passed, stopping = _arriving(world, hit, found, light_in, on)
        planes.add(number, light_in * passed, usable)
        # A glowing body that shades itself: without it this light is gone, and nothing else has changed.
        return number + 1, met | dr.select(usable, stopping & ~row["own"], 0)

    state = mi.UInt32(0), mi.UInt32(path.result.met)
    _, path.result.met = dr.while_loop(state, lambda number, _: on & (number < world.lights.end), step, label="lights")


def _arriving(
    world: World, hit: Hit, found: Sample, light_in: mi.Color3f, on: mi.Bool
) -> tuple[mi.Bool, mi.Float, mi.UInt32]:
    """Tell where a light's sample counts, and there the fraction that gets through and the removable bodies met."""
    usable = on & (found.pdf > 0) & (dr.max(light_in) > 0)
    # Where the shading normal says one side and the surface itself the other, light would leak through.
    usable &= (dr.dot(hit.ng, found.d) > 0) == (dr.dot(hit.ns, found.d) > 0)
    return usable, *_blocked(world, hit, found, usable)


def _bounce(path: PathState, hit: Hit, c: bsdf.Closure, frame: mi.Frame3f, on: mi.Bool) -> None:
    """Go on in a sampled direction, or end."""
    depth, sampler = path.depth, path.sampler
    wo, valid = bsdf.sample(c, sampler.next_1d(LOBE, depth), sampler.next_2d(DIRECTION, depth))
    value, pdf = bsdf.evaluate(c, wo)
    d = frame.to_world(wo)
    leaks = (dr.dot(hit.ng, d) > 0) != (wo.z > 0)
    good = on & valid & (pdf > 0) & ~leaks
    throughput = dr.select(good, path.throughput * value / pdf, 0)
    depth = depth + 1
    chance = dr.minimum(dr.max(throughput), 0.95)
    roulette = depth >= ROULETTE_FROM
    stays = ~roulette | (sampler.next_1d(ROULETTE, depth) < chance)
    throughput = dr.select(roulette & stays, throughput / chance, throughput)
    good &= stays & (dr.max(throughput) > 0)
    path.o = dr.select(good, _start(hit.p, hit.ng, d), path.o)
    path.d = mi.Vector3f(dr.select(good, dr.normalize(d), path.d))
    path.origin = dr.select(good, hit.p, path.origin)
    path.travelled = dr.select(good, mi.Float(0), path.travelled)
    path.throughput = dr.select(good, throughput, path.throughput)
    path.pdf = dr.select(good, pdf, path.pdf)
    path.least_pdf = dr.select(good, dr.minimum(path.least_pdf, pdf), path.least_pdf)
    path.depth = dr.select(good, depth, path.depth)
    path.active = good
