"""The one material: Blender's Principled BSDF (version 4), so that both renderers show the same surface.

Lambertian diffuse under a dielectric GGX layer, GGX metal with Schlick's Fresnel, rough GGX glass, and a clear coat;
layers dim what lies below by their albedo. Sources: Walter et al. 2007 (GGX, refraction); Heitz 2014 (Smith);
Dupuy and Benyoub 2023 (sampling of visible normals); Turquin 2019 and Kulla and Conty 2017 (energy lost to
multiple scattering); Hoffman 2023 (layering by albedo), as Cycles does it. All directions are in the local frame,
+Z the shading normal on the viewer's side; values include the cosine.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy import integrate

from multilight.datagen.backends.mitsuba.device import CLAMPED
from multilight.datagen.backends.mitsuba.surfaces import Hit

LEAST_ALPHA = 1e-3
"""Mirror-like: a lobe of a twentieth of a degree. Float32 carries no sharper one."""
COAT_IOR = 1.5


def fresnel(cosine: mi.Float, eta: mi.Float) -> mi.Float:
    """Reflectance of a smooth dielectric, unpolarized; cosine >= 0, eta = n behind / n in front."""
    g2 = eta * eta - 1 + cosine * cosine
    g = dr.sqrt(dr.maximum(g2, 0))
    a = (g - cosine) / (g + cosine)
    b = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)
    return dr.select(g2 > 0, 0.5 * a * a * (1 + b * b), 1)


def _d(h: mi.Vector3f, alpha: mi.Float) -> mi.Float:
    """GGX distribution of normals, written so that it keeps its digits near the pole."""
    slope = (h.x * h.x + h.y * h.y) / dr.square(alpha) + h.z * h.z
    return dr.select(h.z > 0, dr.rcp(dr.pi * dr.square(alpha * slope)), 0)


def _lambda(v: mi.Vector3f, alpha: mi.Float) -> mi.Float:
    """Smith's Lambda."""
    tan2 = (v.x * v.x + v.y * v.y) / dr.maximum(v.z * v.z, 1e-14)
    return 0.5 * (dr.sqrt(1 + dr.square(alpha) * tan2) - 1)


def _visible_normal(wi: mi.Vector3f, alpha: mi.Float, u: mi.Point2f) -> mi.Vector3f:
    """Sample a normal of those that are visible from wi (Dupuy and Benyoub 2023, spherical caps)."""
    stretched = dr.normalize(mi.Vector3f(wi.x * alpha, wi.y * alpha, wi.z))
    phi = 2 * dr.pi * u.x
    z = dr.fma(1 - u.y, 1 + stretched.z, -stretched.z)
    sine = dr.sqrt(dr.clip(1 - z * z, 0, 1))
    sin_phi, cos_phi = dr.sincos(phi)
    h = mi.Vector3f(sine * cos_phi, sine * sin_phi, z) + stretched
    return dr.normalize(mi.Vector3f(h.x * alpha, h.y * alpha, h.z))


class Tables:
    """Albedos of GGX reflection by (cosine, roughness, index), integrated once on the device.

    `E`: of a perfect reflector (what single scattering keeps); `fraction`: where a dielectric's albedo, energy
    restored, lies between its reflectance at normal incidence (0) and one (1); and what glass keeps, reflected and
    refracted, seen from outside and from inside. The index enters as sqrt((ior - 1) / (ior + 1)).
    """

    COSINES, ROUGHNESSES, INDICES = 32, 16, 12
    GREATEST_INDEX = 0.75  # of ior 3.6

    def __init__(self) -> None:
        grid = dr.meshgrid(
            dr.linspace(mi.Float, 0, 1, self.COSINES),
            dr.linspace(mi.Float, 0, 1, self.ROUGHNESSES),
            dr.linspace(mi.Float, 0, self.GREATEST_INDEX, self.INDICES),
            indexing="ij",
        )
        cosine, roughness, z = (dr.ravel(axis) for axis in grid)
        cosine = dr.clip(cosine, 1e-4, 1)
        alpha = dr.maximum(dr.square(roughness), LEAST_ALPHA)
        kept, reflected, outside = _integrate(cosine, alpha, _ior_of(z))
        inside = _integrate(cosine, alpha, dr.rcp(_ior_of(z)))[2]
        zero = dr.square(dr.square(z))
        fraction = dr.clip((reflected / kept - zero) / (1 - zero), 0, 1)
        shape = (self.COSINES, self.ROUGHNESSES, self.INDICES)
        both = np.stack([np.array(v).reshape(shape) for v in (kept, fraction, outside, inside)], axis=-1)
        # Axes of a texture run x, y, z = last to first.
        self._table = mi.Texture3f(mi.TensorXf(both), **CLAMPED)
        mu = np.linspace(0, 1, self.COSINES)
        average = 2 * integrate.trapezoid(both[..., 0, 0] * mu[:, None], mu, axis=0)
        self._average = mi.Texture1f(mi.TensorXf(average[:, None].astype(np.float32)), **CLAMPED)

    def lookup(self, cosine: mi.Float, roughness: mi.Float, ior: mi.Float) -> tuple[mi.Float, ...]:
        """Return E, its average over the hemisphere, `fraction`, and what glass keeps from outside and from inside."""
        z = dr.sqrt(dr.maximum(ior - 1, 0) / (ior + 1)) / self.GREATEST_INDEX
        sizes = (self.INDICES, self.ROUGHNESSES, self.COSINES)
        where = [(v * (n - 1) + 0.5) / n for v, n in zip((z, roughness, cosine), sizes, strict=True)]
        kept, fraction, outside, inside = self._table.eval(mi.Point3f(*where))
        (average,) = self._average.eval(mi.Point1f(where[1]))
        return kept, average, fraction, outside, inside


def _ior_of(z: mi.Float) -> mi.Float:
    return (1 + z * z) / (1 - z * z)


def _integrate(cosine: mi.Float, alpha: mi.Float, eta: mi.Float) -> list[mi.Float]:
    """Integrate GGX over the outgoing directions: a perfect reflector, a dielectric's reflection, and all of glass."""
    side = 48
    count = dr.width(cosine)
    index = dr.arange(mi.UInt32, count * side * side)
    cell, point = index // (side * side), index % (side * side)
    u = mi.Point2f((mi.Float(point % side) + 0.5) / side, (mi.Float(point // side) + 0.5) / side)
    cosine, alpha, eta = (dr.gather(mi.Float, v, cell) for v in (cosine, alpha, eta))
    wi = mi.Vector3f(dr.sqrt(1 - cosine * cosine), 0, cosine)
    h = _visible_normal(wi, alpha, u)
    wo = h * (2 * dr.dot(wi, h)) - wi
    first = 1 + _lambda(wi, alpha)
    d = dr.dot(wi, h)
    reflectance = fresnel(d, eta)
    weight = dr.select(wo.z > 0, first / (first + _lambda(wo, alpha)), 0)
    reflected = weight * reflectance
    refracted = _refract(wi, h, eta)
    through = dr.select(refracted.z < 0, first / (first + _lambda(refracted, alpha)), 0) * (1 - reflectance)
    return [dr.block_sum(v, side * side) / (side * side) for v in (weight, reflected, reflected + through)]


def _refract(wi: mi.Vector3f, h: mi.Vector3f, eta: mi.Float) -> mi.Vector3f:
    """Refract by Snell's law at a facet of normal h."""
    d, inverse = dr.dot(wi, h), dr.rcp(eta)
    cosine = dr.sqrt(dr.maximum(1 - dr.square(inverse) * (1 - d * d), 0))
    return mi.Vector3f(h * (inverse * d - cosine) - wi * inverse)


def _grey(c: mi.Color3f) -> mi.Float:
    """Average the channels; `dr.mean` would put the number of lanes into the compiled code."""
    return (c.x + c.y + c.z) * (1 / 3)


def _schlick(f0: mi.Color3f, cosine: mi.Float) -> mi.Color3f:
    return f0 + (1 - f0) * dr.power(dr.clip(1 - cosine, 0, 1), 5)


def _restored(kept: mi.Float, average: mi.Float, fss: mi.Color3f | mi.Float) -> mi.Color3f | mi.Float:
    """Return what single scattering is multiplied with to restore what it loses (Turquin 2019, as Cycles has it)."""
    fms = fss * average / (1 - fss * (1 - average))
    return 1 + fms * (1 - kept) / kept


def _layer(tables: Tables, cosine: mi.Float, roughness: mi.Float, ior: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Return what a dielectric layer's single scattering is multiplied with, and the layer's albedo."""
    kept, average, fraction, _, _ = tables.lookup(cosine, roughness, ior)
    # Imageworks' fit of the hemispherical reflectance of a dielectric (Kulla and Conty 2017).
    hemispherical = (ior - 1) / (4.08567 + 1.00071 * ior)
    restored = _restored(kept, average, hemispherical)
    zero = dr.square((ior - 1) / (ior + 1))
    return restored, restored * kept * (zero + (1 - zero) * fraction)


@dataclass
class Closure:
    """A surface as seen from wi: all that does not depend on the other direction."""

    wi: mi.Vector3f
    diffuse: mi.Color3f
    alpha: mi.Float
    metal: mi.Color3f
    """Weight of the metal, energy restored."""
    f0: mi.Color3f
    dielectric: mi.Float
    """Weight of the dielectric's reflection, energy restored."""
    ior: mi.Float
    coat: mi.Float
    coat_alpha: mi.Float
    glass: mi.Color3f | None
    """Weight of the light refracted."""
    glass_reflection: mi.Float | None
    eta: mi.Float | None
    """Index behind over index in front."""
    p_diffuse: mi.Float
    p_gloss: mi.Float
    p_coat: mi.Float
    p_glass: mi.Float


def closure(tables: Tables, hit: Hit, wi: mi.Vector3f, blur: mi.Float, *, glass: bool) -> Closure:
    """Work out the lobes' weights. `blur` is the least alpha; `glass`: whether anything in the scene refracts."""
    cosine = dr.clip(wi.z, 1e-4, 1)
    kept, average, _, outside, inside = tables.lookup(cosine, hit.roughness, hit.ior)
    coat_restored, coat_albedo = _layer(tables, cosine, hit.coat_roughness, mi.Float(COAT_IOR))
    coat_albedo *= hit.coat
    below = 1 - coat_albedo
    metal = below * hit.metallic
    rest = below * (1 - hit.metallic)
    through = rest * hit.transmission if glass else mi.Float(0)
    rest = rest - through
    restored = through / dr.select(hit.inside, inside, outside)
    dielectric_restored, albedo = _layer(tables, cosine, hit.roughness, hit.ior)
    fss_metal = hit.base + (1 - hit.base) * (1 / 21)
    gloss = metal * _grey(_schlick(hit.base, cosine)) + rest * albedo
    diffuse = hit.base * (rest * (1 - albedo))
    weights = [_grey(diffuse), gloss, coat_albedo, through]
    total = dr.maximum(weights[0] + weights[1] + weights[2] + weights[3], 1e-8)
    return Closure(
        wi=mi.Vector3f(wi.x, wi.y, cosine),
        diffuse=diffuse,
        alpha=dr.maximum(dr.maximum(dr.square(hit.roughness), LEAST_ALPHA), blur),
        metal=metal * _restored(kept, average, fss_metal),
        f0=hit.base,
        dielectric=rest * dielectric_restored,
        ior=hit.ior,
        coat=hit.coat * coat_restored,
        coat_alpha=dr.maximum(dr.maximum(dr.square(hit.coat_roughness), LEAST_ALPHA), blur),
        glass=dr.sqrt(hit.base) * restored if glass else None,
        glass_reflection=restored if glass else None,
        eta=dr.select(hit.inside, dr.rcp(hit.ior), hit.ior) if glass else None,
        p_diffuse=weights[0] / total,
        p_gloss=weights[1] / total,
        p_coat=weights[2] / total,
        p_glass=weights[3] / total,
    )


def evaluate(c: Closure, wo: mi.Vector3f) -> tuple[mi.Color3f, mi.Float]:
    """Return the BSDF times |cos| and the density of sampling `wo` [1/sr]."""
    above = wo.z > 0
    h = dr.normalize(c.wi + wo)
    d = dr.dot(c.wi, h)
    lambda_i = _lambda(c.wi, c.alpha)
    common = _d(h, c.alpha) / (4 * c.wi.z)
    reflected = common / (1 + lambda_i + _lambda(wo, c.alpha))
    density = common / (1 + lambda_i)
    dielectric = fresnel(d, c.ior)
    gloss = c.metal * _schlick(c.f0, d) + c.dielectric * dielectric
    coat_lambda = _lambda(c.wi, c.coat_alpha)
    coat_common = _d(h, c.coat_alpha) / (4 * c.wi.z)
    coat = c.coat * fresnel(d, mi.Float(COAT_IOR)) * coat_common / (1 + coat_lambda + _lambda(wo, c.coat_alpha))
    value = c.diffuse * (wo.z * dr.inv_pi) + gloss * reflected + coat
    pdf = c.p_diffuse * wo.z * dr.inv_pi + c.p_gloss * density + c.p_coat * coat_common / (1 + coat_lambda)
    if c.glass is None:
        return dr.select(above, value, 0), dr.select(above, pdf, 0)
    mirrored = fresnel(d, c.eta)
    value += c.glass_reflection * mirrored * reflected
    pdf += c.p_glass * mirrored * density
    through, through_pdf = _refracted(c, wo, lambda_i)
    return dr.select(above, value, through), dr.select(above, pdf, through_pdf)


def _refracted(c: Closure, wo: mi.Vector3f, lambda_i: mi.Float) -> tuple[mi.Color3f, mi.Float]:
    """Refraction through a rough interface (Walter et al. 2007, eq. 21), as radiance carried along a ray's length."""
    h = dr.normalize(c.wi + wo * c.eta)
    h = mi.Vector3f(dr.mulsign(h, h.z))
    i, o = dr.dot(c.wi, h), dr.dot(wo, h)
    possible = (i > 0) & (o < 0) & (wo.z < 0)
    passed = 1 - fresnel(dr.maximum(i, 0), c.eta)
    jacobian = dr.square(c.eta) * dr.abs(o) / dr.maximum(dr.square(i + c.eta * o), 1e-12)
    common = passed * _d(h, c.alpha) * i * jacobian / c.wi.z
    value = c.glass * (common / (1 + lambda_i + _lambda(wo, c.alpha)))
    return dr.select(possible, value, 0), dr.select(possible, c.p_glass * common / (1 + lambda_i), 0)


def sample(c: Closure, lobe: mi.Float, u: mi.Point2f) -> tuple[mi.Vector3f, mi.Bool]:
    """Sample a direction, and tell whether it is one; `evaluate` gives its value and density.

    `lobe` in [0, 1) chooses. Facets that send light to the wrong side of the surface give no direction.
    """
    glossy = lobe >= c.p_diffuse
    coated = glossy & (lobe >= c.p_diffuse + c.p_gloss) & (lobe < c.p_diffuse + c.p_gloss + c.p_coat)
    h = _visible_normal(c.wi, dr.select(coated, c.coat_alpha, c.alpha), u)
    d = dr.dot(c.wi, h)
    mirrored = h * (2 * d) - c.wi
    wo = dr.select(glossy, mirrored, mi.warp.square_to_cosine_hemisphere(u))
    if c.glass is None:
        return mi.Vector3f(wo), wo.z > 0
    start = c.p_diffuse + c.p_gloss + c.p_coat
    reflectance = fresnel(dr.maximum(d, 0), c.eta)
    passes = (lobe >= start) & (lobe >= start + reflectance * c.p_glass)
    wo = mi.Vector3f(dr.select(passes, _refract(c.wi, h, c.eta), wo))
    return wo, (wo.z > 0) != passes
