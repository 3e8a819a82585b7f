"""Messages of a SEFT test: topics, samples <-> bytes, experiment time; parameters, node shell."""

import os

# One thread for linear algebra, set before numpy is first imported: the products here are
# small, threads would compete with the loop's processes, and their number would change bits.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
