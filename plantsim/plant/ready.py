from typing import Literal
Forks = Literal["model", "area"]
def prepared(full, **k): return full
