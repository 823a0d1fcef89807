"""What tests share: scenes, manifests, pictures of scenes, and where the data lies."""

import pytest

pytest.register_assert_rewrite("tests.support.page")  # so that what a check of a page found stands in its failure
