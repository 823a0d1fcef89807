"""Write manifests/vectors anew but for its README.md."""

from tests.makers.vectors.files import make
from tests.support.paths import VECTORS

for name, data in make().items():
    (VECTORS / name).write_bytes(data)
