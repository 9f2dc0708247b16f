"""The text of generated modules."""

from masking.compile.codegen.generated_module import Module

HOSTILE = 'x"""; import os; os.system("touch injected"); """\n\nimport os\u2028\r\x0c#'


def test_a_title_is_no_code_of_a_module():
    text = Module(HOSTILE, {}).text()
    assert [line for line in text.splitlines() if line and not line.startswith(";")] == []
