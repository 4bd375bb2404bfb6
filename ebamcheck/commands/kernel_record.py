"""Write the list of kernels that ``ebamcheck warm`` compiles: ``make kernel-list``.

The main job runs with an empty cache, in a process of its own and one kernel after the other (a few minutes); what the
cache then holds is the list. What other jobs add is listed beside it: a wheel brings it along, too. The list is to be made
again when a kernel gets other arguments, another name or another module, or a new one is called.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from ebamcheck.numeric.kernel_stamp import OUR_PACKAGES
from ebamcheck.scratch import scratch_folder

KERNEL = re.compile(r"^@kernel$", re.MULTILINE)


def record() -> None:
    """Run the jobs here, with the cache as it is, and write down what the cache holds after the main one and after all."""
    from ebamcheck.commands.warm import main_job, other_jobs
    from ebamcheck.numeric.kernel_list import write_list

    with scratch_folder() as folder:
        main_job(Path(folder))
        of_main_job = _cached()
        other_jobs(Path(folder))
        write_list(of_main_job, _cached())


def _cached() -> dict[str, list[str]]:
    from ebamcheck.numeric.kernel_list import cached, kernel_named

    kernels = {name: kernel_named(name) for name in kernel_names()}
    return cached({name: kernel for name, kernel in kernels.items() if kernel is not None})


def kernel_names() -> list[str]:
    """Modules and names of all kernels of this project's packages that are loaded, found in their sources."""
    packages = {name.partition(".")[0] for name in sys.modules if name.startswith(OUR_PACKAGES)}
    found = []
    for package in sorted(packages):
        folder = Path(str(sys.modules[package].__file__)).parent
        for path in sorted(folder.rglob("*.py")):
            source = path.read_text(encoding="utf-8")
            if KERNEL.search(source):
                parts = [package, *path.relative_to(folder).with_suffix("").parts]
                module = ".".join(part for part in parts if part != "__init__")
                names = re.findall(r"^@kernel\n(?:@.*\n)*def (\w+)", source, re.MULTILINE)
                found += [f"{module}.{name}" for name in names]
    return found


def main() -> int:
    """Record in a process that begins with an empty cache."""
    if "NUMBA_CACHE_DIR" in os.environ and sys.argv[1:] == ["--with-this-cache"]:
        record()
        return 0
    with scratch_folder() as folder:
        command = [sys.executable, "-m", "ebamcheck.commands.kernel_record", "--with-this-cache"]
        return subprocess.run(
            command, env={**os.environ, "NUMBA_CACHE_DIR": str(folder)}, check=False
        ).returncode


if __name__ == "__main__":
    sys.exit(main())
