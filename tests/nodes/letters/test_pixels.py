"""Letters in a picture: ambiguous alone, read by their word."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from hierax.nodes.letters.pixels import (
    DRAWN,
    GlyphCamera,
    PictureWorld,
    PixelLetterNode,
    SignPicture,
    draw_glyph,
    draw_picture,
)
from hierax.runtime import Step, Tick
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.process import ActiveHierarchy, update
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.loading.loader import build_hierarchy
from hierax.schemas.values import encode_value

FILE = Path(__file__).parents[3] / "deploy" / "letters-image.yaml"
WORDS = ("THE", "CAT")


def posteriors(*overrides: str, seed: int = 0, epochs: int = 1) -> dict:
    deployment = read_deployment(FILE, overrides)
    hierarchy = build_hierarchy(deployment.roster, OperatorSetting(seed=seed), deployment.allowance)
    active = ActiveHierarchy.initial(hierarchy)
    for _ in range(epochs):
        active = update(active)
    return {name: state.belief["posterior"] for name, state in active.states.items() if name != "world"}


def test_all_that_the_file_names_can_be_imported() -> None:
    names = re.findall(r"hierax[\w.]*:\w+", FILE.read_text())
    assert isinstance(yaml.safe_load(FILE.read_text()), dict)
    assert names
    for name in names:
        module, _, target = name.partition(":")
        assert callable(getattr(importlib.import_module(module), target)), name


@pytest.mark.parametrize("seed", range(20))
def test_the_halfway_sign_is_ambiguous_alone(seed: int) -> None:
    found = posteriors("context=false", seed=seed)
    assert abs(found["letter2"]["A"] - 0.5) < 0.05
    assert found["letter1"]["C"] > 0.999
    assert found["letter3"]["T"] > 0.999


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize(("letters", "word", "middle"), [("C?T", "CAT", "A"), ("T?E", "THE", "H")])
def test_the_word_decides_what_the_halfway_sign_is(letters: str, word: str, middle: str, seed: int) -> None:
    found = posteriors(f"letters={letters}", seed=seed)
    assert found["word"][word] > 0.999
    assert found["letter2"][middle] > 0.999


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize(("ambiguity", "middle"), [(0.0, "H"), (1.0, "A")])
def test_clear_signs_are_read_without_context(ambiguity: float, middle: str, seed: int) -> None:
    found = posteriors("context=false", f"ambiguity={ambiguity}", seed=seed)
    assert found["letter2"][middle] > 0.9


def test_the_sign_goes_from_h_to_a_by_degrees() -> None:
    read = [posteriors("context=false", f"ambiguity={step / 10}")["letter2"]["A"] for step in range(11)]
    assert read == sorted(read)
    assert read[3] == pytest.approx(0.3, abs=0.05)


def test_an_exactly_symmetric_sign_gives_equal_likelihoods() -> None:
    node = PixelLetterNode(WORDS, 2, sigma=30.0)
    found = node.likelihood(draw_glyph("?", 0.5, 32))
    assert found["H"] == pytest.approx(found["A"], abs=1e-12)


def test_the_word_can_overrule_a_clear_letter_without_calling_it_impossible() -> None:
    found = posteriors("letters=TAE")
    assert found["word"]["THE"] > 0.99
    assert found["letter2"]["H"] > 0.99


def test_contradicting_outer_letters_leave_the_word_open() -> None:
    found = posteriors("letters=T?T")
    assert found["word"]["THE"] == pytest.approx(0.5, abs=0.05)


def test_every_epoch_has_its_own_noise_and_a_seed_repeats_it() -> None:
    camera = GlyphCamera(2, noise=30.0)
    belief = PictureWorld("C?T").initial_belief()
    first, again, later = (
        camera(belief, tick=Tick(seed=3, subject="world->letter2", operator="sense", epoch=epoch))[0]
        for epoch in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, later)
    assert (first - draw_glyph("?", 0.5, 32).astype(int)).std() == pytest.approx(30.0, abs=2.0)


def test_a_seed_gives_the_same_beliefs_to_the_bit() -> None:
    assert encode_value(posteriors(seed=5, epochs=3)) == encode_value(posteriors(seed=5, epochs=3))


def test_the_picture_is_the_signs_in_a_row() -> None:
    picture = draw_picture("C?T", 0.5, 24)
    assert picture.shape == (24, 72)
    assert picture.dtype == np.uint8
    assert np.array_equal(picture[:, 24:48], draw_glyph("?", 0.5, 24))


def test_the_sign_between_ends_at_h_and_at_a() -> None:
    assert np.array_equal(draw_glyph("?", 0.0, 32), draw_glyph("H", 0.0, 32))
    assert np.array_equal(draw_glyph("?", 1.0, 32), draw_glyph("A", 0.0, 32))


def test_no_two_letters_look_alike() -> None:
    assert len({draw_glyph(letter, 0.0, 32).tobytes() for letter in DRAWN}) == len(DRAWN)


def test_a_camera_without_a_sign_says_so() -> None:
    with pytest.raises(OperatorError, match=r"^world->letter3: .*no sign 3 in 'CA'"):
        posteriors("letters=CA")


@pytest.mark.parametrize("pixels", [np.zeros((4, 5), np.uint8), np.zeros((4, 4)), [[0]], np.zeros((0, 0), np.uint8)])
def test_an_observation_that_is_no_square_of_pixels_is_refused(pixels: object) -> None:
    with pytest.raises(ValueError, match="expected a square of pixels, uint8"):
        PixelLetterNode(WORDS, 1, sigma=1.0).likelihood(pixels)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PictureWorld("CXT"), "letters: expected signs out of A, C, E, H, T, [?]"),
        (lambda: PictureWorld("CAT", 1.5), "ambiguity: expected a number from 0 to 1"),
        (lambda: PictureWorld("CAT", "much"), "ambiguity: .*'much'"),
        (lambda: GlyphCamera(1, -1.0), "noise: "),
        (lambda: GlyphCamera(1, 1.0, 4), "size: "),
        (lambda: GlyphCamera(0, 1.0), "letter: "),
        (lambda: PixelLetterNode(("DOG", "CAT"), 1, 1.0), "no glyph for D"),
        (lambda: PixelLetterNode(WORDS, 1, 0.0), "sigma: "),
        (lambda: PixelLetterNode(WORDS, 1, 1.0, 0.0), "slip: "),
    ],
)
def test_bad_parameters_are_refused(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_the_probe_writes_what_was_seen(tmp_path: Path) -> None:
    pixels = draw_glyph("A", 0.0, 16)
    probe = SignPicture("letter.png", enlarge=2)
    probe.open(tmp_path)
    probe.record(Step(1, 0, 0.0, (pixels,), None, (), (), "default", (), None))
    probe.close()
    written = cv2.imread(str(tmp_path / "letter.png"), cv2.IMREAD_GRAYSCALE)
    assert np.array_equal(written[::2, ::2], pixels)


def test_the_probe_writes_nothing_without_an_output_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    probe = SignPicture("letter.png")
    probe.open(None)
    probe.record(Step(1, 0, 0.0, (draw_glyph("A", 0.0, 16),), None, (), (), "default", (), None))
    probe.close()
    assert not list(tmp_path.iterdir())
