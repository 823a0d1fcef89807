"""Where the data of the tests lies."""

from pathlib import Path

REPOSITORY = Path(__file__).parent.parent.parent
PACKAGE = REPOSITORY / "airgs_codec"
DATA = REPOSITORY / "tests" / "data"
FOX = DATA / "fox"  # the embedded sequence
FOX_VIEWS = DATA / "fox_views"  # its pictures
GOLDEN = REPOSITORY / "tests" / "golden"
CORPUS = REPOSITORY / "manifests"
VECTORS = CORPUS / "vectors"  # test vectors for readers in any language
VALID = CORPUS / "valid"
INVALID = CORPUS / "invalid"
