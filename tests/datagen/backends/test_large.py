"""Large pictures are made in little memory, and come out as they would otherwise, to the last bit."""

from pathlib import Path

import numpy as np
import pytest

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.machine.mitsuba_variant import choose_variant
from multilight.datagen.backends.protocol import RenderSettings
from multilight.datagen.production import view as made
from multilight.datagen.production.stopwatch import Stopwatch
from multilight.datagen.storage.layers import GeometryBuffers
from multilight.datagen.storage.store import ViewData, read_view, write_view
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.spec import Texture
from tests.datagen.backends.contract_scenes import RIG, still_life


def test_a_large_picture_has_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if choose_variant().variant is None:
        pytest.skip(f"Mitsuba cannot run here: {choose_variant().why}")
    from multilight.datagen.backends.mitsuba import backend, film

    with open_backend("mitsuba", AssetLibrary(tmp_path / "cache", packs=())) as opened:
        settings = RenderSettings(spp=8, max_bounces=2, threads=1)

        def view(name: str) -> ViewData:
            opened.synced = None  # type: ignore[attr-defined]
            setup = made.SceneSetup(opened, still_life(), RIG, settings, denoise=True, keep_raw=True, scratch=tmp_path)
            data = made.render_view(setup, 0, Stopwatch()).data
            write_view(tmp_path / name, data)
            return data

        view("usual.exr")
        for module in (made, backend, film):
            monkeypatch.setattr(module, "LARGE", 0)
        monkeypatch.setattr(backend, "LANES", 1000)
        assert view("large.exr").variants["all"].dtype == np.float32
    assert (tmp_path / "usual.exr").read_bytes() == (tmp_path / "large.exr").read_bytes()
    assert not list(tmp_path.glob("tmp*"))


def test_layers_kept_in_half_are_those_of_the_file(tmp_path: Path) -> None:
    """One layer would overflow in half precision, and is stored in single."""
    path = tmp_path / "view.exr"
    layers = np.random.default_rng(2).random((2, 16, 24, 3), dtype=np.float32)
    layers[1] *= 1e5
    _written(path, layers)
    plain, compact = read_view(path), read_view(path, compact=True)
    assert list(compact.variants) == list(plain.variants)
    for name, values in plain.variants.items():
        assert compact.variants[name].dtype == np.float32
        np.testing.assert_array_equal(compact.variants[name], values)


def _written(path: Path, layers: np.ndarray) -> None:
    plane, colour = np.zeros(layers.shape[1:3], np.float32), np.zeros(layers.shape[1:], np.float32)
    geometry = GeometryBuffers(plane, colour, colour, plane, plane, plane.astype(np.uint16), plane)
    write_view(path, ViewData(("a", "b"), {"all": layers}, {}, geometry, colour))


def test_textures_stay_where_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if choose_variant().variant is None:
        pytest.skip(f"Mitsuba cannot run here: {choose_variant().why}")
    open_backend("mitsuba", AssetLibrary(tmp_path, packs=()))  # chooses the variant
    from multilight.datagen.backends.mitsuba.arrays import Textures

    images = {name: np.full((2, 3), number, np.uint32) for number, name in enumerate(("a", "b", "c"), start=1)}
    monkeypatch.setattr("multilight.datagen.backends.mitsuba.arrays._read_words", lambda path: images[path.name])
    library = AssetLibrary(tmp_path, packs=())
    monkeypatch.setattr(library, "texture_path", lambda image: tmp_path / image)
    monkeypatch.setattr(Textures, "ROOM", 12)
    monkeypatch.setattr(Textures, "MOST_KEPT", 18)
    textures = Textures(library)
    places = [textures.place(Texture(image=name)) for name in ("a", "b", "a")]
    assert places == [(2, 3, 2), (8, 3, 2), (2, 3, 2)]
    before = textures.words()
    textures.begin()
    assert textures.place(Texture(image="c"))[0] == 14  # beyond the room: it grows
    assert textures.words().tolist() == [0, 0, *[1] * 6, *[2] * 6, *[3] * 6]
    assert before.tolist() == [0, 0, *[1] * 6, *[2] * 6]
    textures.begin()
    assert textures.place(Texture(image="b"))[0] == 2, "too much was kept, and is forgotten"
