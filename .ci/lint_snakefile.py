"""Snakemake's own linter over the Snakefile; exit status 1 and the complaints when there are any.

One complaint is passed over: that every rule should name a conda environment or a container. All
rules share one environment, that of requirements.lock, which the same Python that runs Snakemake
belongs to; a second description of it would go stale.
"""

import re
import subprocess
import sys

PASSED_OVER = "Specify a conda environment or container for each rule."

# Exit status 1 with complaints, 0 without; anything else, or complaints in another form than that
# read here, must not pass for a clean Snakefile.
done = subprocess.run(
    [sys.executable, "-m", "snakemake", "--lint"], capture_output=True, text=True, check=False
)
output = done.stdout + done.stderr
titles = re.findall(r"^    \* (.*):$", output, flags=re.MULTILINE)
understood = bool(titles) if done.returncode == 1 else done.returncode == 0

if not understood or set(titles) - {PASSED_OVER}:
    sys.exit(output)
