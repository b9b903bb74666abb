"""Calls motes_digest of the arm64 library on an emulated processor, with Android's own C library.

usage: emulated.py LIBRARY FOLDER-WITH-LIBANDROID SCENE OUTPUT
"""

import sys
import time
from pathlib import Path

from emulite import AndroidEmulator64, AndroidProfile

library, stubs, scene, output = sys.argv[1:]
profile = AndroidProfile(package_name="org.motes.viewer", seed=1)
emulator = AndroidEmulator64(profile=profile, search_paths=[stubs])
guest_scene = "/data/data/org.motes.viewer/files/" + Path(scene).name
guest_output = "/data/data/org.motes.viewer/files/digest.json"
emulator.add_file(guest_scene, Path(scene).read_bytes())
begun = time.time()
module = emulator.load_library(library)
print(f"loaded {module.name} in {time.time() - begun:.1f} s", file=sys.stderr)
begun = time.time()
code = module.call_symbol("motes_digest", guest_scene, guest_output)
print(f"motes_digest returned {code} after {time.time() - begun:.1f} s", file=sys.stderr)
if code != 0:
    try:
        print(emulator.read_file(guest_output).decode(errors="replace"), file=sys.stderr)
    except Exception as error:  # The file need not be there.
        print(f"it left no message ({error})", file=sys.stderr)
    sys.exit(1)
for suffix in ["", ".values"]:
    Path(output + suffix).write_bytes(emulator.read_file(guest_output + suffix))
