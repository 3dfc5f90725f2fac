"""`python -m rig`, which imports nothing of the folder that it is called in, as `rig` does."""

import os
import sys

if __name__ == "__main__":
    if sys.path[:1] == [os.getcwd()] != [os.path.dirname(os.path.dirname(os.path.abspath(__file__)))]:
        del sys.path[0]
    from rig.cli import main

    main()
