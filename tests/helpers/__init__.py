"""What more than one file of tests uses."""

import pytest

pytest.register_assert_rewrite(*(f"{__name__}.{name}" for name in ("commands", "files")))
