"""The committed vectors are those that their programs make, and their page names them all."""

from tests.makers.vectors.files import make
from tests.support.paths import VECTORS

MOST_BYTES = 600_000
PAGE = "README.md"


def test_the_vectors_are_made_anew_alike():
    made = make()
    assert sorted(made) == sorted(path.name for path in VECTORS.iterdir() if path.name != PAGE)
    for name, data in made.items():
        assert (VECTORS / name).read_bytes() == data, f"{name}: run python -m tests.makers.vectors"


def test_the_vectors_are_small():
    assert sum(path.stat().st_size for path in VECTORS.iterdir()) < MOST_BYTES


def test_the_page_names_every_file():
    text = (VECTORS / PAGE).read_text()
    assert [path.name for path in VECTORS.iterdir() if f"`{path.name}`" not in text and path.name != PAGE] == []
