"""The command `bounce`."""

import time
from typing import Final

#: When this process began to import: a budget counts from here.
BEGAN: Final = time.monotonic()
