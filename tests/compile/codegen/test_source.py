"""The text of generated modules, read by Python's own parser."""

import ast

from masking.compile.codegen.source import Module

HOSTILE = 'x"""; import os; os.system("touch injected"); """\n\nimport os\u2028\r\x0c#'


def test_a_title_is_no_code_of_a_module():
    kernels, expressions = (Module(HOSTILE, {}, functions=functions) for functions in (["one = 1"], []))
    plain = Module("title", {}, functions=["one = 1"])
    assert ast.dump(ast.parse(kernels.text())) == ast.dump(ast.parse(plain.text()))
    assert [line for line in expressions.text().splitlines() if line and not line.startswith(";")] == []
