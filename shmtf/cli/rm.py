# SPDX-License-Identifier: Apache-2.0
"""`shmtf rm`: remove stores.  Processes that have one mapped keep it until they let go."""

from __future__ import annotations

import argparse
import os
import re
import sys
import time
from collections.abc import Sequence

from ._common import CliError, printable

_BELL = re.compile(r"\.shmtf-bell-([0-9a-f]{32})")
_NEW_S = 10.0  # a bell younger than this may belong to a store that is just being made


def run(prog: str, argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        prog=prog,
        allow_abbrev=False,
        description="Remove stores by name. One that processes still map is removed only with --force; they keep it.",
    )
    parser.add_argument("names", metavar="NAME", nargs="*", help="a store")
    parser.add_argument(
        "-f", "--force", action="store_true", help="also if mapped, or no store at all; missing ones do not matter"
    )
    parser.add_argument("--sweep", action="store_true", help="also remove bells whose store is gone")
    args = parser.parse_args(argv)
    if not args.names and not args.sweep:
        parser.error("give a NAME, or --sweep")
    failed = 0
    if args.names:
        from ._holders import holders

        holding = holders(args.names)
        for name in dict.fromkeys(args.names):
            problem = _remove(name, holding[name], args.force)
            if problem:
                print(f"{prog}: {problem}", file=sys.stderr)
                failed = 1
    if args.sweep:
        sweep()
    return failed


def _remove(name: str, holding: list[tuple[int, str]], force: bool) -> str | None:
    """What is wrong, or None."""
    from .. import Store, StoreError, StoreNotFoundError, StorePermissionError

    shown = f'"{printable(name)}"'
    who = ", ".join(f"{printable(process)} ({pid})" for pid, process in holding)
    try:
        Store.attach(name, readonly=True).close()
    except StoreNotFoundError:
        return None if force else f"there is no store {shown}"
    except StorePermissionError:
        pass  # who may not read it may still be its directory's owner
    except StoreError as error:
        if not force:
            return f"{printable(str(error))}; --force removes it all the same"
    if holding and not force:
        return f"{shown} is mapped by {who}; --force removes the name, they keep what they have"
    try:
        Store.unlink(name)
    except StoreNotFoundError:
        return None if force else f"there is no store {shown}"
    except StoreError as error:
        return printable(str(error))
    print(f"removed {shown}" + (f", still mapped by {who}" if holding else ""))
    return None


def sweep() -> None:
    """Remove this user's bells that no store and no process uses."""
    from .. import Store, StoreError, list_stores
    from ._holders import DIRECTORY, holders

    bells = [entry for entry in os.scandir(DIRECTORY) if _BELL.fullmatch(entry.name) and _may_go(entry)]
    used = {name for name, who in holders(bell.name for bell in bells).items() if who}
    for store in list_stores():  # after the bells, so that every store of theirs is seen
        try:
            with Store.attach(store, readonly=True) as attached:
                its_bell = f".shmtf-bell-{attached._info()['uuid']}"
        except StoreError:
            continue
        if not _BELL.fullmatch(its_bell):
            raise CliError(f'which bell is that of store "{printable(store)}" cannot be told; nothing was swept')
        used.add(its_bell)
    orphans = [bell for bell in bells if bell.name not in used]
    for bell in orphans:
        try:
            os.unlink(bell.path)
        except OSError as error:
            print(f"{bell.path}: {error.strerror}", file=sys.stderr)
    print(f"removed {len(orphans)} orphan bell{'' if len(orphans) == 1 else 's'}, kept {len(bells) - len(orphans)}")


def _may_go(entry: os.DirEntry[str]) -> bool:
    try:
        status = entry.stat(follow_symlinks=False)
    except OSError:
        return False
    return status.st_uid == os.geteuid() and time.time() - status.st_mtime > _NEW_S
