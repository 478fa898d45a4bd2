# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences of a module as they are seen: what is put in while it runs is found in the module, or is an example.

Names are followed to what was assigned before, to the rows of a table that a loop goes through, to the arguments of
calls within the module, to values of dictionaries and to what functions return. What cannot be found so (a name in a
scene, a number, a path) is an example: `EXAMPLES` by the expression, else a name or a number.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from itertools import islice, product

from tools.message_examples import EXAMPLES

#: Sentences that one call may say, at most: more would be variations only.
_MOST = 12
#: How far names are followed.
_DEPTH = 6
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_UNKNOWN = "\0"

Rows = dict[str, ast.expr]


def _called(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def _parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    return [argument.arg for argument in function.args.args if argument.arg not in ("self", "cls")]


def _calls(call: ast.Call, function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether a call is of a function, by its name and by how many arguments it takes."""
    most, count = len(_parameters(function)), len(call.args) + len(call.keywords)
    return _called(call) == function.name and most - len(function.args.defaults) <= count <= most + len(
        function.args.kwonlyargs
    )


class Module:
    """A module's text, for finding what its expressions may say.

    Parameters
    ----------
    source : str
    examples : dict
        What expressions say that are not found: `EXAMPLES`, or others for this module.
    """

    def __init__(self, source: str, examples: dict[str, str] = EXAMPLES) -> None:
        self._examples = examples
        self._whole = frozenset(examples.values())
        self.tree = ast.parse(source)
        self._parents = {child: node for node in ast.walk(self.tree) for child in ast.iter_child_nodes(node)}
        self._functions = {node.name: node for node in ast.walk(self.tree) if isinstance(node, _FUNCTIONS)}

    def texts(self, *expressions: ast.expr) -> list[tuple[str, ...]]:
        """What expressions of one call may say together; nothing of those of which nothing is known."""
        found: dict[tuple[str, ...], None] = {}
        for row in self._rows(expressions):
            each = [self._texts(expression, row, _DEPTH) for expression in expressions]
            for choice in islice(product(*each), _MOST):
                # What is put in whole was said elsewhere.
                if all(text.strip(f"{_UNKNOWN}: ") and text not in self._whole for text in choice):
                    found[tuple(text.replace(_UNKNOWN, "Cube") for text in choice)] = None
        return list(found)

    def _ancestors(self, node: ast.AST) -> Iterator[ast.AST]:
        while node in self._parents:
            node = self._parents[node]
            yield node

    def _scope(self, node: ast.AST) -> ast.AST:
        """The function that a statement belongs to, else the module."""
        return next((item for item in self._ancestors(node) if isinstance(item, _FUNCTIONS)), self.tree)

    def _rows(self, expressions: tuple[ast.expr, ...]) -> list[Rows]:
        """What names are in each row of a table that a loop around the call goes through."""
        for loop in self._ancestors(expressions[0]):
            if isinstance(loop, ast.For) and isinstance(loop.target, ast.Tuple) and isinstance(loop.iter, ast.Tuple):
                names = [name.id if isinstance(name, ast.Name) else "" for name in loop.target.elts]
                rows = [row.elts for row in loop.iter.elts if isinstance(row, ast.Tuple)]
                return [dict(zip(names, row, strict=False)) for row in rows] or [{}]
        return self._calls(expressions) or [{}]

    def _calls(self, expressions: tuple[ast.expr, ...]) -> list[Rows]:
        """What the module passes, call by call, to the function around a call that says several of its parameters."""
        function = next((item for item in self._ancestors(expressions[0]) if isinstance(item, _FUNCTIONS)), None)
        if function is None:
            return []
        names = _parameters(function)
        said = {node.id for expression in expressions for node in ast.walk(expression) if isinstance(node, ast.Name)}
        if len(said.intersection(names)) < 2:
            return []
        return [
            dict(zip(names, call.args, strict=False)) | {item.arg: item.value for item in call.keywords if item.arg}
            for call in (node for node in ast.walk(self.tree) if isinstance(node, ast.Call))
            if _calls(call, function)
        ]

    def _texts(self, node: ast.expr, row: Rows, depth: int) -> list[str]:
        if depth == 0:
            return [_UNKNOWN]
        if isinstance(node, ast.Constant):
            return [str(node.value)]
        if isinstance(node, ast.JoinedStr):
            return self._joined([self._put_in(part, row, depth) for part in node.values])
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            return self._joined([self._texts(node.left, row, depth), self._texts(node.right, row, depth)])
        if isinstance(node, ast.IfExp):
            return [*self._texts(node.body, row, depth), *self._texts(node.orelse, row, depth)]
        example = self._examples.get(ast.unparse(node))
        if example is not None:
            return [example]
        values = list(self._values(node, row))
        texts = [text for value in values for text in self._texts(value, {}, depth - 1)]
        return texts or [_UNKNOWN]

    def _put_in(self, part: ast.expr, row: Rows, depth: int) -> list[str]:
        if not isinstance(part, ast.FormattedValue):
            return self._texts(part, row, depth)
        texts = self._texts(part.value, row, depth)
        if part.format_spec is not None:  # a number
            texts = ["12" if text == _UNKNOWN else text for text in texts]
        return [repr(text) for text in texts] if part.conversion == ord("r") else texts

    @staticmethod
    def _joined(parts: list[list[str]]) -> list[str]:
        return ["".join(choice) for choice in islice(product(*parts), _MOST)]

    def _values(self, node: ast.expr, row: Rows) -> Iterator[ast.expr]:
        """Expressions that a name, a look-up or a call of the module's own functions may stand for."""
        if isinstance(node, ast.Name):
            if node.id in row:
                yield row[node.id]
            else:
                yield from self._assigned(node) or self._arguments(node)
        elif isinstance(node, ast.Subscript):
            yield from self._dictionary(node.value)
        elif isinstance(node, ast.Call):
            name = _called(node)
            if name == "get" and isinstance(node.func, ast.Attribute):
                yield from self._dictionary(node.func.value)
                yield from node.args[1:]
            elif name in self._functions:
                returned = (item for item in ast.walk(self._functions[name]) if isinstance(item, ast.Return))
                yield from (item.value for item in returned if item.value is not None)

    def _dictionary(self, node: ast.expr) -> list[ast.expr]:
        tables = [node] if isinstance(node, ast.Dict) else self._assigned(node) if isinstance(node, ast.Name) else []
        return [value for table in tables if isinstance(table, ast.Dict) for value in table.values]

    def _assigned(self, node: ast.Name) -> list[ast.expr]:
        """What may have been assigned to a name where it is read: the nearest before, and those that may count yet."""
        around = list(self._ancestors(node))
        scopes = [item for item in around if isinstance(item, (*_FUNCTIONS, ast.Module))]
        for scope in scopes:
            found = [
                (item.lineno, item)
                for item in ast.walk(scope)
                if isinstance(item, ast.Assign | ast.AnnAssign)
                and item.value is not None
                and self._names(item, node.id)
                and (item.lineno <= node.lineno or isinstance(scope, ast.Module)) and self._scope(item) is scope
            ]
            values: list[ast.expr] = []
            for _line, item in sorted(found, key=lambda entry: entry[0], reverse=True):
                if item in around:
                    continue
                values.append(item.value)  # type: ignore[arg-type]
                if self._parents[item] in around:
                    break
            if values:
                return values
        return []

    @staticmethod
    def _names(item: ast.Assign | ast.AnnAssign, name: str) -> bool:
        targets = item.targets if isinstance(item, ast.Assign) else [item.target]
        return any(isinstance(target, ast.Name) and target.id == name for target in targets)

    def _arguments(self, node: ast.Name) -> list[ast.expr]:
        """What the module passes for a parameter."""
        function = next((item for item in self._ancestors(node) if isinstance(item, _FUNCTIONS)), None)
        if function is None:
            return []
        names = _parameters(function)
        if node.id not in names:
            return []
        place, found = names.index(node.id), []
        for call in ast.walk(self.tree):
            if isinstance(call, ast.Call) and _calls(call, function):
                found += [item.value for item in call.keywords if item.arg == node.id]
                found += call.args[place : place + 1]
        return found
