"""The gap workflow: where do model and logs disagree, what is missing, does adding it help."""

import os

# The workflow's matrices are small and its own loops already use all cores: threads of the linear
# algebra would only wait for each other. Read when numpy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
