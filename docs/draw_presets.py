"""Draw docs/presets.png: what each preset makes of healthy data, but for those of draw_spoofs.py.

python docs/draw_presets.py
"""

import runpy
from pathlib import Path

from PIL import Image

from mavproxy_fault.app.preview import draw_preview
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.schedule.presets import preset_names

DOCS = Path(__file__).parent
PICTURE = DOCS / "presets.png"

if __name__ == "__main__":
    elsewhere = runpy.run_path(str(DOCS / "draw_spoofs.py"))["PRESETS"]
    shown = [{"preset": name} for name in preset_names() if name not in elsewhere]
    draw_preview(parse_schedule({"seed": 1, "faults": shown}), PICTURE)
    # A third of the bytes, and no difference to the eye.
    Image.open(PICTURE).convert("RGB").quantize(256).save(PICTURE, optimize=True)
