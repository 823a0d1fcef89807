"""What experiments say of their options: fields of a frozen dataclass, as those of the commands."""

from airgs_codec._settings import required, setting
from airgs_codec.cli.options import Given, expect_names, given, nested

__all__ = ["Given", "expect_names", "given", "nested", "required", "setting"]
