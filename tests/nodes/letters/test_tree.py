"""Letters under a word: the paper's values, enumeration, impossible evidence, bad parameters."""

from __future__ import annotations

import importlib
import itertools
import math
import random
import re
from pathlib import Path

import pytest
import yaml

from hierax.nodes.letters import LetterNode, SymbolWorld, WordNode
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.process import ActiveHierarchy, update
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.loading.loader import build_hierarchy
from hierax.schemas.values import encode_value

FILE = Path(__file__).parents[3] / "deploy" / "letters.yaml"
WORDS = ("THE", "CAT")
NODES = ("letter1", "letter2", "letter3")


def run(*overrides: str, epochs: int = 1) -> ActiveHierarchy:
    deployment = read_deployment(FILE, overrides)
    hierarchy = build_hierarchy(deployment.roster, OperatorSetting(), deployment.allowance)
    active = ActiveHierarchy.initial(hierarchy)
    for _ in range(epochs):
        active = update(active)
    return active


def beliefs(*overrides: str, epochs: int = 1) -> dict:
    return {name: state.belief for name, state in run(*overrides, epochs=epochs).states.items()}


def enumerated(words: tuple[str, ...], priors: list[float], likelihoods: list[dict[str, float]]) -> dict:
    """All posteriors, by summing over every word and every letter at every place."""
    alphabets = [sorted({word[place] for word in words}) for place in range(len(words[0]))]
    joint: dict[tuple[str, str], float] = {}
    for word, prior in zip(words, priors, strict=True):
        for letters in itertools.product(*alphabets):
            given_word = float("".join(letters) == word)
            seen = math.prod(table[letter] for table, letter in zip(likelihoods, letters, strict=True))
            joint[word, "".join(letters)] = prior * given_word * seen
    total = math.fsum(joint.values())

    def share(wanted) -> float:
        return math.fsum(p for (word, letters), p in joint.items() if wanted(word, letters)) / total

    result = {"word": {name: share(lambda word, _, name=name: word == name) for name in words}}
    for place, alphabet in enumerate(alphabets):
        result[f"letter{place + 1}"] = {
            name: share(lambda _, letters, name=name, place=place: letters[place] == name) for name in alphabet
        }
    return result


def assert_posteriors(found: dict, expected: dict, what: object) -> None:
    for node, posterior in expected.items():
        for name, probability in posterior.items():
            assert abs(found[node]["posterior"][name] - probability) <= 1e-12, (what, node, name)


def test_all_that_the_file_names_can_be_imported() -> None:
    names = re.findall(r"hierax[\w.]*:\w+", FILE.read_text())
    assert isinstance(yaml.safe_load(FILE.read_text()), dict)
    assert names
    for name in names:
        module, _, target = name.partition(":")
        assert callable(getattr(importlib.import_module(module), target)), name


def test_the_papers_values_exactly() -> None:
    found = beliefs()
    assert found["word"]["diagnostic"] == {
        "letter1": {"THE": 0.0, "CAT": 1.0},
        "letter2": {"THE": 0.5, "CAT": 0.5},
        "letter3": {"THE": 0.0, "CAT": 1.0},
    }
    assert found["word"]["posterior"] == {"THE": 0.0, "CAT": 1.0}
    assert found["letter2"] == {
        "diagnostic": {"H": 0.5, "A": 0.5},
        "causal": {"H": 0.0, "A": 1.0},
        "posterior": {"H": 0.0, "A": 1.0},
    }


def test_hypotheses_stand_in_the_papers_order() -> None:
    found = beliefs()
    assert [list(found[name]["posterior"]) for name in (*NODES, "word")] == [
        ["T", "C"],
        ["H", "A"],
        ["E", "T"],
        ["THE", "CAT"],
    ]


@pytest.mark.parametrize(("letters", "word", "middle"), [("C?T", "CAT", "A"), ("T?E", "THE", "H")])
def test_the_same_sign_is_read_both_ways(letters: str, word: str, middle: str) -> None:
    found = beliefs(f"letters={letters}")
    assert found["letter2"]["diagnostic"] == {"H": 0.5, "A": 0.5}
    assert found["word"]["posterior"][word] == 1.0
    assert found["letter2"]["posterior"][middle] == 1.0


def test_a_clear_middle_letter_decides_for_its_neighbours() -> None:
    found = beliefs("letters=?A?")
    assert found["letter1"]["posterior"] == {"T": 0.0, "C": 1.0}
    assert found["letter3"]["posterior"] == {"E": 0.0, "T": 1.0}


def test_without_context_the_middle_letter_stays_open() -> None:
    found = beliefs("context=false")
    assert found["word"]["posterior"] == {"THE": 0.0, "CAT": 1.0}
    assert found["letter2"]["posterior"] == {"H": 0.5, "A": 0.5}


@pytest.mark.parametrize("seed", range(20))
def test_random_likelihoods_agree_with_enumeration(seed: int) -> None:
    rng = random.Random(seed)
    values = [[rng.random() for _ in range(2)] for _ in range(3)]
    priors = [rng.random() for _ in range(2)]
    overrides = [f"likelihood{place}={pair}" for place, pair in enumerate(values, 1)] + [f"priors={priors}"]
    tables = [{word[place]: values[place][i] for i, word in enumerate(WORDS)} for place in range(3)]
    assert_posteriors(beliefs(*overrides), enumerated(WORDS, priors, tables), overrides)


@pytest.mark.parametrize("seed", range(20))
def test_larger_vocabularies_agree_with_enumeration(seed: int) -> None:
    rng = random.Random(seed)
    words = ("THE", "CAT", "CAR", "HAT", "TAR")
    alphabets = [list(dict.fromkeys(word[place] for word in words)) for place in range(3)]
    values = [[rng.choice([0.0, 1.0, rng.random()]) for _ in alphabet] for alphabet in alphabets]
    values[1] = [0.3, 0.7]
    values[0][1] = values[2][1] = 0.2  # CAT is never ruled out
    priors = [rng.random() for _ in words]
    overrides = [f"words=[{', '.join(words)}]", f"priors={priors}"]
    overrides += [f"likelihood{place}={row}" for place, row in enumerate(values, 1)]
    tables = [dict(zip(alphabet, row, strict=True)) for alphabet, row in zip(alphabets, values, strict=True)]
    assert_posteriors(beliefs(*overrides), enumerated(words, priors, tables), overrides)


def test_one_epoch_is_exact_and_further_ones_change_nothing() -> None:
    overrides = ("likelihood1=[0.3, 0.4]", "likelihood2=[0.1, 0.7]", "priors=[0.9, 0.1]")
    assert encode_value(beliefs(*overrides)) == encode_value(beliefs(*overrides, epochs=5))


def test_evidence_of_tiny_probability_comes_out_right() -> None:
    found = beliefs(
        "priors=[1, 1.0e-12]", "likelihood1=[1, 1.0e-200]", "likelihood2=[0, 1.0e-200]", "likelihood3=[1, 1.0e-200]"
    )
    assert found["word"]["posterior"] == {"THE": 0.0, "CAT": 1.0}
    assert [found[name]["posterior"][right] for name, right in zip(NODES, "CAT", strict=True)] == [1.0, 1.0, 1.0]


def test_impossible_evidence_is_an_error_that_names_the_node() -> None:
    with pytest.raises(OperatorError, match=r"^word: .*impossible.*THE, CAT"):
        run("likelihood1=[1, 0]", "likelihood3=[0, 1]")


def test_impossible_prior_is_an_error_that_names_the_node() -> None:
    with pytest.raises(OperatorError, match=r"^word: .*letter1, letter2, letter3 together.*impossible"):
        run("priors=[1, 0]", "likelihood1=[0, 1]")


def test_metrics_are_the_posteriors() -> None:
    active = run()
    metrics = {name: active.hierarchy.nodes[name].metrics(state.belief) for name, state in active.states.items()}
    assert metrics["word"] == {"THE": 0.0, "CAT": 1.0}
    assert metrics["letter2"] == {"H": 0.0, "A": 1.0}


def test_an_epoch_without_observations_keeps_the_evidence() -> None:
    node = LetterNode(WORDS, 1)
    belief = node.observe(({"T": 0.25, "C": 0.75},), node.initial_belief())
    assert node.observe((), belief) == belief
    assert node.predict((), (), belief) == belief
    word = WordNode(WORDS, [1, 3])
    assert word.observe((), word.initial_belief())["posterior"] == {"THE": 0.25, "CAT": 0.75}


def test_a_letter_refuses_likelihoods_of_other_letters() -> None:
    node = LetterNode(WORDS, 1)
    with pytest.raises(ValueError, match="T, C"):
        node.observe(({"H": 1.0, "A": 0.0},), node.initial_belief())


@pytest.mark.parametrize(
    ("words", "likelihoods", "letters", "message"),
    [
        (["THE", "CAT"], [[1, 0], [1, 0]], None, "likelihoods: expected 3"),
        (["THE", "CAT"], [[1, 0], [1, 0], [1]], None, "likelihoods: letter 3: expected 2 numbers, for E, T"),
        (["THE", "CAT"], [[1, 0], [1, -1], [1, 0]], None, "likelihoods: letter 2: .*at least 0"),
        (["THE", "CAT"], [[1, 0], [1, float("nan")], [1, 0]], None, "likelihoods: letter 2: .*finite"),
        (["THE", "CAT"], [[0, 0], [1, 1], [1, 0]], None, "likelihoods: letter 1: .*more than 0"),
        (["THE", "CAT"], [[1, 0], "ab", [1, 0]], None, "likelihoods: letter 2: .*'ab'"),
        (["THE", "CATS"], [], None, "words of one length"),
        (["THE", "THE"], [], None, "different words"),
        ("THE", [], None, "a list of words"),
        (["THE", "CAT"], [], "C?", "letters: expected 3"),
        (["THE", "CAT"], [], "CXT", "letters: expected one of H, A or [?] at 2, got 'X'"),
    ],
)
def test_bad_parameters_are_refused(words, likelihoods, letters, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SymbolWorld(words, likelihoods, letters)


def test_a_place_outside_of_the_words_is_refused() -> None:
    with pytest.raises(ValueError, match="from 1 to 3, got 4"):
        LetterNode(WORDS, 4)


def test_a_word_node_takes_over_what_the_letters_have_reported() -> None:
    belief = beliefs("likelihood2=[0.3, 0.7]", "likelihood1=[1, 1]", "likelihood3=[1, 1]")["word"]
    taken = WordNode(WORDS, [0.9, 0.1]).take_over(belief)
    assert taken["diagnostic"] == belief["diagnostic"]
    assert taken["causal"] == pytest.approx({"THE": 0.9, "CAT": 0.1})
    assert taken["posterior"] == pytest.approx({"THE": 0.27 / 0.34, "CAT": 0.07 / 0.34})


@pytest.mark.parametrize(
    ("belief", "what"),
    [
        (0.5, "belief: expected dict, got float"),
        (LetterNode(WORDS, 1).initial_belief(), "belief.diagnostic.T: expected dict, got float"),
        (WordNode(("THE", "HAT")).initial_belief(), "belief.causal: expected the keys"),
        (
            {**WordNode(WORDS).initial_belief(), "diagnostic": {"letter1": {"THE": 1.0}}},
            "belief.diagnostic.letter1: expected the keys ['CAT', 'THE'], got ['THE']",
        ),
    ],
)
def test_a_word_node_takes_over_no_belief_of_another_kind(belief: object, what: str) -> None:
    with pytest.raises(ValueError, match=re.escape(what)):
        WordNode(WORDS).take_over(belief)
