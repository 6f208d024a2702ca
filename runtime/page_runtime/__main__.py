"""python -m page_runtime: the same as page-runtime."""

import sys

from page_runtime.cli import main

sys.exit(main())
