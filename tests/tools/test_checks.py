# SPDX-License-Identifier: Apache-2.0
"""Each of the project's own rules finds what it forbids: a small project with one fault, and the line that says so."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).resolve().parents[2] / "tools"
SPDX = "SPDX-License-Identifier: Apache-2.0"
CMAKE = """# SPDX-License-Identifier: Apache-2.0
set(SHMTF_SEGMENT_SOURCES segment/layout.c segment/map.c)
set(SHMTF_CORE_SOURCES core/low.c core/high.c)
set(SHMTF_API_SOURCES)
set(SHMTF_PYTHON_SOURCES)
"""
SOUND = {
    "native/CMakeLists.txt": CMAKE,
    "native/MEMORY_MODEL.md": "## E1 publication\n| E1 | `one.c` |\n",
    "tests/model/weak/one.c": f"/* {SPDX}\n * E1 */\n",
    "tests/model/weak/two.c": f"/* {SPDX} */\n",
    "native/segment/atomic.h": f"/* {SPDX} */\n#include <stdatomic.h>\ntypedef _Atomic int word;\n",
    "native/segment/layout.h": f"""/* {SPDX} */
#include <stddef.h>
#include <stdint.h>
typedef struct {{const char *record, *field; uint32_t offset, size; const char *rule;}} shmtf_field;
const shmtf_field *shmtf_layout_fields(size_t *n);
""",
    "native/segment/layout.c": f"""/* {SPDX} */
#include "segment/layout.h"
static const shmtf_field fields[] = {{{{"header", "magic", 0, 8, "creator"}}, {{"header", "size", 16, 8, "creator"}}}};
const shmtf_field *shmtf_layout_fields(size_t *n) {{ *n = 2; return fields; }}
""",
    "native/segment/map.h": f"/* {SPDX} */\nint shmtf_map(void);\n",
    "native/segment/map.c": f'/* {SPDX} */\n#include <sys/mman.h>\n#include "segment/map.h"\n',
    "native/core/low.h": f"/* {SPDX} */\nint low(int x);\n",
    "native/core/low.c": f'/* {SPDX} */\n#include "core/low.h"\nint low(int x) {{ return x; /* [E1 release] */ }}\n',
    "native/core/high.h": f"/* {SPDX} */\nint high(void);\n",
    "native/core/high.c": f"""/* {SPDX} */
#include "core/high.h"
#include "core/low.h"
/* [E1 acquire] pairs with [E1 release] in low.c */
int high(void) {{ return low(1); }}
""",
    "shmtf/__init__.py": f"# {SPDX}\n",
}


class Project:
    def __init__(self, root: Path) -> None:
        self.root = root
        (root / "tools").mkdir()
        for tool in [*TOOLS.glob("*.py"), *TOOLS.glob("*.c")]:
            shutil.copy(tool, root / "tools")
        for name, text in SOUND.items():
            self.write(name, text)
        self.check("layout", "--write")

    def write(self, name: str, text: str) -> None:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def append(self, name: str, text: str) -> None:
        self.write(name, (self.root / name).read_text() + text)

    def check(self, name: str, *arguments: str) -> tuple[int, str]:
        command = [sys.executable, str(self.root / "tools" / f"check_{name}.py"), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout + done.stderr


@pytest.fixture
def project(tmp_path: Path) -> Project:
    return Project(tmp_path)


@pytest.mark.parametrize("name", ["layers", "edges", "layout", "tokens"])
def test_sound_project_passes(project: Project, name: str) -> None:
    status, text = project.check(name)
    assert status == 0, text


FAULTS = [
    ("layers", "native/core/low.c", '#include "segment/map.h"\n', "core may not include os"),
    ("layers", "native/core/low.c", "#include <stdlib.h>\n", "core may not include <stdlib.h>"),
    ("layers", "native/core/low.c", '#include "core/high.h"\n', "high.h comes after low.c"),
    ("layers", "native/core/low.c", "int high(void);\nint f(void) { return high(); }\n", "needs high"),
    ("layers", "native/core/low.c", "int getpid(void);\nint f(void) { return getpid(); }\n", "needs getpid"),
    ("layers", "native/core/extra.c", f"/* {SPDX} */\n", "not in native/CMakeLists.txt"),
    ("layers", "shmtf/__init__.py", "from .cli import main\n", "shmtf/ may not import cli"),
    ("layers", "shmtf/cli/tool.py", f"# {SPDX}\nimport ctypes\n", "reached through _core alone"),
    ("edges", "native/core/low.c", "/* [E2 release] */\n", "E2 is not in MEMORY_MODEL.md"),
    ("edges", "native/core/low.c", "/* [E2 release] */\n", "E2 has no [E2 acquire] end"),
    ("edges", "native/core/low.c", "/* [E3 seq_cst] */\n", "E3 has one [E3 seq_cst] end"),
    ("edges", "native/core/low.c", "/* pairs with [E1 acquire] in low.c */\n", "which is not there"),
    ("edges", "native/MEMORY_MODEL.md", "## E9 nothing\n", "E9 has no end in the code"),
    ("edges", "native/MEMORY_MODEL.md", "## E9 nothing\n", "E9 has no scenario"),
    ("edges", "native/MEMORY_MODEL.md", "| E1 | `none.litmus` |\n", "none.litmus is not there"),
    ("edges", "native/MEMORY_MODEL.md", "| E1 | `two.c` |\n", "two.c is not there, or not about it"),
    ("edges", "native/core/low.c", "volatile int x;\n", "volatile is spelled in segment/atomic.h alone"),
    ("edges", "native/core/low.c", "int y; int f(void) { return __atomic_load_n(&y, 0); }\n", "is spelled in"),
    ("layout", "native/LAYOUT.md", "one more line\n", "stale"),
    ("tokens", "shmtf/long.py", f"# {SPDX}\n" + "x = 1\n" * 350, "351 lines, at most 350"),
    ("tokens", "native/core/low.c", "int g(void) {\n" + "\n" * 80 + "return 0;\n}\n", "g: 83 lines, at most 80"),
    ("tokens", "shmtf/long.py", f"# {SPDX}\ndef f():\n" + "    x = 1\n" * 80, "f: 81 lines, at most 80"),
    ("tokens", "shmtf/plain.py", "x = 1\n", "no SPDX-License-Identifier"),
    ("tokens", "notes.md", "TO" + "DO: later\n", "unfinished work"),
    ("tokens", "notes.md", "look in /" + "home/me/x\n", "a path of one machine"),
]


@pytest.mark.parametrize(("check", "name", "added", "message"), FAULTS, ids=lambda value: value[:40])
def test_fault_is_found(project: Project, check: str, name: str, added: str, message: str) -> None:
    if (project.root / name).exists():
        project.append(name, added)
    else:
        project.write(name, added)
    status, text = project.check(check)
    assert status == 1, text
    assert message in text
    if "\n" in text and check != "layers":
        assert any(line.startswith(f"{name}:") for line in text.splitlines())


@pytest.mark.parametrize("offsets", ["{0, 8}, {4, 8}", "{0, 4}, {8, 8}"])
def test_layout_is_whole_words_without_overlap(project: Project, offsets: str) -> None:
    first, second = (pair.strip("{} ").replace(" ", "") for pair in offsets.split("}, {"))
    text = SOUND["native/segment/layout.c"].replace("0, 8", first).replace("16, 8", second)
    project.write("native/segment/layout.c", text)
    project.check("layout", "--write")
    status, output = project.check("layout")
    assert status == 1, output
    assert "overlaps" in output or "whole words" in output
