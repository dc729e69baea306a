import numpy as np
import pytest

from multilight.datagen.errors import UserError
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData
from multilight.datagen.tuples import compose
from multilight.lights.spec import LightingCondition

View = tuple[SceneRecord, ViewData]


def two_lightings(view: ViewData) -> tuple[LightingCondition, LightingCondition]:
    first, *others = view.lights
    base = LightingCondition(name="base", gains={first: (1.0, 0.5, 2.0)}, exposure_ev=1.0)
    insert = LightingCondition(name="insert", gains=dict.fromkeys(others, (0.3, 1.0, 0.1)))
    return insert, base


def test_composite_is_the_background_outside_and_the_target_inside(sphere_view: View) -> None:
    record, view = sphere_view
    _, lit = two_lightings(view)
    for name in record.scene.insertable:
        alpha = view.coverage[name]
        assert (alpha >= 1).any()
        pasted = compose.composite(view, name, insert=lit, base=lit)
        np.testing.assert_array_equal(pasted[alpha <= 0], compose.background(view, name, lit)[alpha <= 0])
        np.testing.assert_allclose(pasted[alpha >= 1], compose.target(view, lit)[alpha >= 1], rtol=1e-6)


def test_composite_takes_the_object_from_one_light_and_the_rest_from_the_other(sphere_view: View) -> None:
    record, view = sphere_view
    insert, base = two_lightings(view)
    name = record.scene.insertable[0]
    alpha = view.coverage[name]
    pasted = compose.composite(view, name, insert=insert, base=base)
    np.testing.assert_allclose(pasted[alpha >= 1], compose.target(view, insert)[alpha >= 1], rtol=1e-6)
    np.testing.assert_array_equal(pasted[alpha <= 0], compose.background(view, name, base)[alpha <= 0])


def test_edges_carry_no_halo(sphere_view: View) -> None:
    """With one lighting, a composite's edge lies between the target and what differs by the shadow alone."""
    record, view = sphere_view
    everything = LightingCondition(name="all", gains=dict.fromkeys(view.lights, (1.0, 1.0, 1.0)))
    for name in record.scene.insertable:
        alpha = view.coverage[name]
        edge = (alpha > 0) & (alpha < 1)
        pasted = compose.composite(view, name, insert=everything, base=everything)[edge]
        truth = compose.target(view, everything)[edge]
        empty = compose.background(view, name, everything)[edge]
        most = (1 - alpha[edge])[:, None] * empty
        assert (pasted - truth <= most + 1e-3).all()
        assert (pasted - truth >= -most - 1e-3).all()


def test_effect_is_zero_where_the_object_has_no_influence(sphere_view: View) -> None:
    record, view = sphere_view
    name, shares = record.scene.insertable[0], []
    for light in view.lights:
        lit = LightingCondition(name=light, gains={light: (1.0, 0.5, 2.0)}, exposure_ev=1.0)
        change = compose.effect(view, name, lit)
        np.testing.assert_array_equal(change, compose.target(view, lit) - compose.background(view, name, lit))
        shares.append((change == 0).all(axis=-1).mean())
        assert (change < 0).any()
    assert max(shares) > 0.3


def test_unknown_object_is_named(sphere_view: View) -> None:
    _, view = sphere_view
    _, lit = two_lightings(view)
    with pytest.raises(UserError, match=r"teapot.*not insertable"):
        compose.background(view, "teapot", lit)
