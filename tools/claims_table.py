"""Turn what ``seft paper --json`` prints into the table of docs/paper.md.

Claims whose two values are equal are omitted: they restate the configuration.
"""

import json
import sys

found = json.load(sys.stdin)
print("| claim | where | paper | ours | agrees |\n|---|---|---|---|---|")
for claim in found["claims"]:
    if claim["ours"] == claim["paper"]:
        continue
    verdict = "yes" if claim["agrees"] else "**no**"
    cells = (claim["claim"], claim["where"], claim["paper"], claim["ours"], verdict)
    print("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
