"""One linear-algebra thread in each of the parallel workers; set before numpy is imported."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
