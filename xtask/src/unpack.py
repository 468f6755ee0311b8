"""Takes the named members out of wheels (zip archives); a member that ends in `/` stands for its whole folder.

Called by `cargo xtask libtorch`: wheels-folder target-folder (wheel-prefix member destination)...
The standard library of Rust reads no zip archives; that of Python does, and Python is here for pip anyway.
"""
import glob
import os
import shutil
import sys
import zipfile


def copy(archive, member, target):
    os.makedirs(os.path.dirname(target), exist_ok=True)
    with archive.open(member) as source, open(target, "wb") as sink:
        shutil.copyfileobj(source, sink, 1 << 20)


def unpack(wheel, member, target):
    with zipfile.ZipFile(wheel) as archive:
        files = [name for name in archive.namelist() if not name.endswith("/")]
        chosen = [name for name in files if name == member or member.endswith("/") and name.startswith(member)]
        if not chosen:
            sys.exit("error: `%s` has no member `%s`" % (os.path.basename(wheel), member))
        for name in chosen:
            copy(archive, name, target + name[len(member):])


def main(wheels, target, *members):
    for prefix, member, destination in zip(*[iter(members)] * 3):
        found = glob.glob(os.path.join(glob.escape(wheels), prefix + "-*.whl"))
        if len(found) != 1:
            sys.exit("error: expected one file `%s-*.whl`, found %d" % (prefix, len(found)))
        unpack(found[0], member, os.path.join(target, destination))


try:
    main(*sys.argv[1:])
except (OSError, zipfile.BadZipFile) as problem:
    sys.exit("error: cannot unpack: %s" % problem)
