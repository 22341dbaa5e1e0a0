"""The paper reproduced: runs, tables, figures and a report, each number beside the printed one.

It uses the engine and nothing else of the project; `morph reproduce` runs it.
"""

from morph_engine.optional_packages import require

require("matplotlib", "httpx", extra="reproduce", purpose="The reproduction")
