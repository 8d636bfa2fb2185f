"""``python -m gyrobench``."""

from gyrobench.bench.cli import main

if __name__ == "__main__":
    main()
