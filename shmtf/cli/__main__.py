# SPDX-License-Identifier: Apache-2.0
"""`python -m shmtf.cli` is `shmtf`."""

import sys

from . import main

sys.exit(main())
