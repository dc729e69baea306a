"""The per-light path integrator: one path, a sum for each light.

Mitsuba's own `path` integrator, except that light is booked to the emitter that it came from. At each vertex
every light is sampled once, or (`one_light`) one of them at random as the built-in integrator does; hits are
weighted against that by the power heuristic (Veach 1997). The book also says which removable bodies a sample has
met, so that a variant without one of them traces only those samples again.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from multilight.datagen.backends.mitsuba import bsdf
from multilight.datagen.backends.mitsuba.lights import AnyEmitter, Environment, Glow, Sample
from multilight.datagen.backends.mitsuba.sampling import Sampler
from multilight.datagen.backends.mitsuba.surfaces import Hit, Soup, Surfaces

SEE_THROUGH_SURFACES = 32
FILTER_GLOSSY = 0.25
"""Cycles' `blur_glossy`: after a diffuse bounce lobes get at least some width, against fireflies."""
SHARP = 10.0
"""Density (1/sr) of directions above which a bounce shows a picture of what it meets: GGX of roughness below 0.3."""
ROULETTE_FROM = 3
LIGHT, LOBE, DIRECTION, ROULETTE, OPACITY = 16, 0, 1, 2, 3


@dataclass
class World:
    """What paths run through: triangles (with or without a body), surfaces, lights.

    `fixed` are the opaque triangles that stay in every variant, `changing` the others that are there, insertable or
    see-through: light that is blocked by the former is blocked whatever is removed.
    """

    whole: Soup
    fixed: Soup | None
    changing: Soup | None
    surfaces: Surfaces
    emitters: list[AnyEmitter]
    tables: bsdf.Tables
    bits: mi.UInt32
    """By body number: the bit of a removable body, else 0."""


@dataclass
class Book:
    """What one sample brings: a colour for each light, the removable bodies it met, and what it saw first."""

    layers: list[mi.Color3f]
    met: mi.UInt32
    first: mi.UInt32
    """The body seen first, 0 where there was none."""
    covered: mi.Bool
    """Some surface was there, see-through or not."""
    albedo: mi.Color3f
    normal: mi.Normal3f
    steps: mi.UInt32
    """How often a ray was followed."""
    seen: mi.UInt32
    """Of the removable bodies that were met, those that the path saw: straight, in mirrors or through glass."""


def _weight(a: mi.Float, b: mi.Float) -> mi.Float:
    """Power heuristic."""
    a2 = a * a
    return dr.select(a2 > 0, a2 / (a2 + b * b), 0)


def _start(p: mi.Point3f, ng: mi.Normal3f, d: mi.Vector3f) -> mi.Point3f:
    """Move a ray's start off its surface."""
    reach = (1 + dr.max(dr.abs(p))) * mi.Float(dr.epsilon(mi.Float) * 1500)
    return mi.Point3f(p + ng * dr.mulsign(reach, dr.dot(ng, d)))


def _blocked(world: World, hit: Hit, found: Sample, active: mi.Bool) -> tuple[mi.Float, mi.UInt32]:
    """Return the share of light that gets through, and the removable bodies that stand in its way."""
    o = _start(hit.p, hit.ng, found.d)
    way = hit.p + found.d * found.distance - o
    distance = dr.norm(way)
    ray = mi.Ray3f(o, way / distance, distance * (1 - dr.epsilon(mi.Float) * 15000), 0.0, mi.Color0f())
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


def _dimmed(world: World, changing: Soup, ray: mi.Ray3f, active: mi.Bool) -> tuple[mi.Float, mi.UInt32]:
    """`_blocked` by triangles that may be see-through: each lets its share pass."""

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


def trace(world: World, ray: mi.Ray3f, sampler: Sampler, *, max_bounces: int, one_light: bool = False) -> Book:
    """Trace one path a lane; radiance is that of its first point, as seen along the ray.

    Lights but the environment and glowing bodies are invisible to the ray itself, and block nothing.
    """
    lights = len(world.emitters)
    state = {
        "active": mi.Bool(True),
        "o": mi.Point3f(ray.o),
        "d": mi.Vector3f(ray.d),
        "depth": mi.UInt32(0),
        "passes": mi.UInt32(0),
        "travelled": mi.Float(0),
        "throughput": mi.Color3f(1),
        "pdf": mi.Float(0),
        "least_pdf": mi.Float(dr.inf),
        "origin": mi.Point3f(ray.o),
        "sampler": sampler,
        "book": Book(
            [mi.Color3f(0) for _ in range(lights)],
            mi.UInt32(0),
            mi.UInt32(0),
            mi.Bool(False),
            mi.Color3f(0),
            mi.Normal3f(0),
            mi.UInt32(0),
            mi.UInt32(0),
        ),
    }

    def step(s):  # type: ignore[no-untyped-def]
        return (_vertex(world, s, max_bounces, one_light),)

    (state,) = dr.while_loop((state,), lambda s: s["active"], step, label="paths")
    return state["book"]


def _vertex(world: World, s: dict, max_bounces: int, one_light: bool) -> dict:
    active, depth, book, sampler = s["active"], s["depth"], s["book"], s["sampler"]
    pi = world.whole.scene.ray_intersect_preliminary(
        mi.Ray3f(s["o"], s["d"], dr.inf, 0.0, mi.Color0f()), coherent=depth == 0, active=active
    )
    book.steps += dr.select(active, mi.UInt32(1), 0)
    found = active & pi.is_valid()
    face = world.whole.face(pi, found)
    hit = world.surfaces.hit(face, pi.prim_uv, mi.Ray3f(s["o"], s["d"]), found)
    bit = dr.select(found, dr.gather(mi.UInt32, world.bits, hit.body, found), 0)
    book.met |= bit
    book.seen |= dr.select(s["least_pdf"] > SHARP, bit, 0)
    distance = s["travelled"] + dr.select(found, pi.t, dr.inf)
    solid = mi.Bool(found)
    if world.surfaces.see_through:
        solid &= sampler.next_1d(OPACITY, depth + s["passes"] * 64) < hit.opacity
    first = depth == 0
    seen = first & solid
    book.first = dr.select(seen, hit.body, book.first)
    book.covered |= first & found
    book.albedo = dr.select(seen, hit.base, book.albedo)
    book.normal = dr.select(seen, hit.ns, book.normal)
    _emission(world, s, hit, distance, (solid, found), 1 / len(world.emitters) if one_light else 1.0)
    on = solid & (depth <= max_bounces)
    frame = mi.Frame3f(hit.ns)
    least = 4 if FILTER_GLOSSY == 0 else s["least_pdf"] / FILTER_GLOSSY
    blur = dr.select(least < 1, dr.sqrt(dr.maximum(1 - least, 0)) * 0.5, 0)
    c = bsdf.closure(world.tables, hit, frame.to_local(-s["d"]), blur, glass=world.surfaces.glass)
    (_direct_one if one_light else _direct)(world, s, hit, c, frame, on)
    _bounce(s, hit, c, frame, on)
    if world.surfaces.see_through:
        passing = found & ~solid & (s["passes"] < SEE_THROUGH_SURFACES)
        s["o"] = dr.select(passing, mi.Point3f(_start(hit.p, hit.ng, s["d"])), s["o"])
        s["passes"] = dr.select(passing, s["passes"] + 1, s["passes"])
        s["travelled"] = dr.select(passing, distance, s["travelled"])
        s["active"] |= passing
    return s


def _emission(world: World, s: dict, hit: Hit, distance: mi.Float, met: tuple[mi.Bool, mi.Bool], chance: float) -> None:
    """Book what the ray itself meets: the environment, glowing surfaces and, after a bounce, lamps.

    `met`: whether there is an opaque surface, and whether there is any. `chance`: of a light to be sampled.
    """
    first = s["depth"] == 0
    solid, found = met
    for number, light in enumerate(world.emitters):
        if light.delta:
            continue
        if isinstance(light, Glow):
            there = solid & (hit.glow == number)
            pdf = light.density(dr.dot(hit.ng, s["d"]), dr.norm(hit.p - s["origin"]))
            radiance = light.radiance() * world.surfaces.glow_texture(hit, there)
        else:
            meets, radiance, pdf = light.met(s["origin"], s["d"])
            there = s["active"] & (~found if light.distant else (meets > s["travelled"]) & (meets < distance))
            if not isinstance(light, Environment):
                there &= ~first
        weight = dr.select(first, 1, _weight(s["pdf"], pdf * chance))
        s["book"].layers[number] += dr.select(there, s["throughput"] * radiance * weight, 0)


def _direct(world: World, s: dict, hit: Hit, c: bsdf.Closure, frame: mi.Frame3f, on: mi.Bool) -> None:
    """Sample every light."""
    book = s["book"]
    for number, light in enumerate(world.emitters):
        found = light.sample(hit.p, s["sampler"].next_2d(LIGHT + number, s["depth"]))
        value, pdf = bsdf.evaluate(c, frame.to_local(found.d))
        weight = mi.Float(1) if light.delta else _weight(found.pdf, pdf)
        light_in = s["throughput"] * value * found.weight * weight
        # Where the shading normal says yes and the surface itself no, light would leak through.
        usable = on & (found.pdf > 0) & (dr.max(light_in) > 0)
        if not world.surfaces.glass:
            usable &= dr.dot(hit.ng, found.d) > 0
        passed, met = _blocked(world, hit, found, usable)
        if isinstance(light, Glow):
            # A glowing body that shades itself: without it this light is gone, and nothing else has changed.
            met &= ~dr.gather(mi.UInt32, world.bits, light.body)
        book.met |= dr.select(usable, met, 0)
        book.layers[number] += dr.select(usable, light_in * passed, 0)


def _direct_one(world: World, s: dict, hit: Hit, c: bsdf.Closure, frame: mi.Frame3f, on: mi.Bool) -> None:
    """Sample one of the lights, each with the same chance."""
    book, count = s["book"], len(world.emitters)
    u = s["sampler"].next_2d(LIGHT, s["depth"])
    scaled = u.x * count
    chosen = dr.minimum(mi.UInt32(scaled), count - 1)
    u = mi.Point2f(scaled - mi.Float(chosen), u.y)
    found = Sample(mi.Vector3f(0, 0, 1), mi.Float(0), mi.Color3f(0), mi.Float(0))
    delta = mi.Bool(False)
    for number, light in enumerate(world.emitters):
        found = dr.select(chosen == number, light.sample(hit.p, u), found)
        delta |= (chosen == number) & light.delta
    value, pdf = bsdf.evaluate(c, frame.to_local(found.d))
    weight = dr.select(delta, 1, _weight(found.pdf / count, pdf)) * count
    light_in = s["throughput"] * value * found.weight * weight
    usable = on & (found.pdf > 0) & (dr.max(light_in) > 0)
    if not world.surfaces.glass:
        usable &= dr.dot(hit.ng, found.d) > 0
    passed, met = _blocked(world, hit, found, usable)
    book.met |= dr.select(usable, met, 0)
    for number in range(count):
        book.layers[number] += dr.select(usable & (chosen == number), light_in * passed, 0)


def _bounce(s: dict, hit: Hit, c: bsdf.Closure, frame: mi.Frame3f, on: mi.Bool) -> None:
    """Go on in a sampled direction, or end."""
    depth, sampler = s["depth"], s["sampler"]
    wo, valid = bsdf.sample(c, sampler.next_1d(LOBE, depth), sampler.next_2d(DIRECTION, depth))
    value, pdf = bsdf.evaluate(c, wo)
    d = frame.to_world(wo)
    leaks = (dr.dot(hit.ng, d) > 0) != (wo.z > 0)
    good = on & valid & (pdf > 0) & ~leaks
    throughput = dr.select(good, s["throughput"] * value / pdf, 0)
    depth = depth + 1
    chance = dr.minimum(dr.max(throughput), 0.95)
    roulette = depth >= ROULETTE_FROM
    stays = ~roulette | (sampler.next_1d(ROULETTE, depth) < chance)
    throughput = dr.select(roulette & stays, throughput / chance, throughput)
    good &= stays & (dr.max(throughput) > 0)
    s["o"] = dr.select(good, _start(hit.p, hit.ng, d), s["o"])
    s["d"] = mi.Vector3f(dr.select(good, dr.normalize(d), s["d"]))
    s["origin"] = dr.select(good, hit.p, s["origin"])
    s["travelled"] = dr.select(good, mi.Float(0), s["travelled"])
    s["throughput"] = dr.select(good, throughput, s["throughput"])
    s["pdf"] = dr.select(good, pdf, s["pdf"])
    s["least_pdf"] = dr.select(good, dr.minimum(s["least_pdf"], pdf), s["least_pdf"])
    s["depth"] = dr.select(good, depth, s["depth"])
    s["active"] = good
