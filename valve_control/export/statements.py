# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Translates statements, and finds where their variables are declared."""

import ast
import inspect
import re
import typing
from collections.abc import Sequence
from pathlib import Path

from valve_control.export import kinds
from valve_control.export.emission import IN_C, wrapped
from valve_control.export.expressions import Expressions
from valve_control.export.kinds import INTEGER, NOTHING, REAL, Kind, comment
from valve_control.export.terms import Function, Term, named
from valve_control.export.values import INDENT


class Body(Expressions):
    """A function as a whole."""

    def arguments(self, given: Sequence[Kind]) -> tuple[Kind, ...]:
        """Kinds of the arguments: those of the annotations, else those ``given``."""
        a = self._parsed.args
        if a.vararg or a.kwarg or a.kwonlyargs or a.posonlyargs:
            raise self.refused(self._parsed, f"{self._parsed.name} has other than plain arguments")
        if self._function.__closure__ or self._parsed.decorator_list:
            raise self.refused(
                self._parsed, f"{self._parsed.name} is decorated, or made inside another function"
            )
        try:
            hints = typing.get_type_hints(self._function)
        except NameError as error:
            raise self.refused(self._parsed, f"the annotations of {self._parsed.name}: {error}") from error
        found = []
        for argument, kind in zip(a.args, given, strict=True):
            said = kinds.of_annotation(hints[argument.arg]) if argument.arg in hints else None
            found.append(said or kind)
        self._returns = kinds.of_annotation(hints["return"]) if "return" in hints else None
        return tuple(found)

    def translate(self, name: str, wanted: tuple[Kind, ...]) -> Function:
        """Write the function ``name`` into the program."""
        program = self._program
        given = []
        for argument, kind in zip(self._parsed.args.args, wanted, strict=True):
            own = IN_C["memory"] if kind.is_memory else self._local(argument.arg)
            if kind.is_memory:
                given.append(self._type(argument, kind, f"*{own}"))
                self._scope[argument.arg] = Term(own, kind, has_address=True, pointer=True)
            elif not kind.is_struct:
                given.append(self._type(argument, kind, own))
                self._scope[argument.arg] = Term(own, kind, has_address=True)
            elif argument.arg in self._stored:
                given.append(f"const {self._type(argument, kind, f'*{own}_given')}")
                self._line(f"{program.declared(kind, own)} = *{own}_given;")
                self._scope[argument.arg] = Term(own, kind, has_address=True)
            else:
                given.append(f"const {self._type(argument, kind, f'*{own}')}")
                self._scope[argument.arg] = Term(own, kind, has_address=True, pointer=True)
            self._declared[argument.arg] = kind
        head, self._lines = self._lines, []
        ended = self._block(self._parsed.body)
        body, self._lines = self._lines, head
        used = set(re.findall(r"\w+", "\n".join([*head, *body])))
        for argument, kind in zip(self._parsed.args.args, wanted, strict=True):
            if not kind.is_memory and self._local(argument.arg) not in used:
                self._line(f"(void){self._local(argument.arg)};")
        self._lines += self._head + body
        returns = self._returns or NOTHING
        if not ended and returns is not NOTHING:
            raise self.refused(self._parsed, f"{self._parsed.name} can end without a result")
        signature = f"static {program.declared(returns, name)}({', '.join(given) or 'void'})"
        file = Path(self._function.__code__.co_filename)
        about = f"/* {file.parent.name}/{file.name}, {self._function.__name__}"
        text = (inspect.getdoc(self._function) or "").splitlines()
        about += f": {comment(text[0])} */" if text else " */"
        lines = [*wrapped(about, ""), *wrapped(signature, ""), "{", *self._lines, "}"]
        program.functions.append("\n".join(lines))
        return Function(name, wanted, returns)

    # Statements

    def _block(self, body: Sequence[ast.stmt]) -> bool:
        """Translate statements; returns whether they end with a return."""
        for i, statement in enumerate(body):
            if self._statement(statement):
                if i + 1 < len(body):
                    raise self.refused(body[i + 1], "this is never reached")
                return True
        return False

    def _statement(self, node: ast.stmt) -> bool:
        said = self._said.get(node.end_lineno or node.lineno, "") if not isinstance(node, ast.If) else ""
        self._check_order(node)
        if self._is_left_out(node):
            return False
        if isinstance(node, ast.Return):
            self._return(node, said)
            return True
        if isinstance(node, ast.If):
            return self._if(node)
        if isinstance(node, ast.Try):
            return self._try(node)
        if isinstance(node, ast.For):
            self._for(node)
            return False
        if isinstance(node, ast.Assign):
            if len(node.targets) != 1:
                raise self.refused(node, "a chain of assignments")
            self._assign(node.targets[0], node.value, said)
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            self._annotated(node, said)
        elif isinstance(node, ast.AugAssign):
            left = ast.parse(ast.unparse(node.target), mode="eval").body
            if not isinstance(node.target, (ast.Name, ast.Attribute)):
                raise self.refused(node, "an assignment to something else than a variable")
            value = ast.copy_location(ast.BinOp(left, node.op, node.value), node)
            self._assign(node.target, value, said)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            self._line(f"{self._expression(node.value).code};", said)
        elif isinstance(node, ast.Pass) or (
            isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        ):
            pass
        else:
            raise self.refused(node, named(node))
        return False

    def _return(self, node: ast.Return, said: str) -> None:
        if node.value is None:
            if self._returns not in (None, NOTHING):
                raise self.refused(node, "a return without a value")
            self._returns = NOTHING
            self._line("return;")
            return
        term = self._expression(node.value, self._returns)
        if self._returns is None:
            self._returns = term.kind
        self._line(f"return {self._as(term, self._returns, node).value};", said)

    def _if(self, node: ast.If, opening: str = "") -> bool:
        """An if with all that follows it; ``opening``: what is before its word, of an if behind an else."""
        self._line(f"{opening}if ({self._truth(node.test).value}) {{", self._said.get(node.lineno, ""))
        ended = self._nested(node.body)
        rest = node.orelse
        if not rest:
            self._line("}")
            return False
        if len(rest) == 1 and isinstance(rest[0], ast.If) and not self._needs_lines(rest[0]):
            return self._if(rest[0], "} else ") and ended
        self._line("} else {")
        ended = self._nested(rest) and ended
        self._line("}")
        return ended

    def _try(self, node: ast.Try) -> bool:
        """What is tried: C raises no error of arithmetic, and goes on with what it computes instead."""
        caught = [self._resolved(e) for h in node.handlers for e in getattr(h.type, "elts", [h.type])]
        if node.orelse or node.finalbody or not {*caught} <= {ArithmeticError, ValueError, Exception}:
            raise self.refused(
                node, "a try block for other errors than ArithmeticError, ValueError and Exception"
            )
        return self._block(node.body)

    # What changes a memory, and when

    def _check_order(self, node: ast.stmt) -> None:
        """Refuse a call that may change a memory where C leaves open when it happens, or leaves it out."""
        whole: ast.AST | None = getattr(node, "test" if isinstance(node, ast.If) else "value", None)
        if isinstance(node, ast.AugAssign):
            whole = None
        if isinstance(whole, ast.UnaryOp) and isinstance(whole.op, ast.Not):
            whole = whole.operand
        parts = [node.test] if isinstance(node, ast.If) else [node]
        if isinstance(node, (ast.For, ast.Try)):
            parts = [node.iter] if isinstance(node, ast.For) else []
        for part in parts:
            for call in ast.walk(part):
                if call is not whole and isinstance(call, ast.Call) and self._takes_memory(call):
                    text = f"{ast.unparse(call.func)} may change its memory inside another expression"
                    raise self.refused(call, text)

    def _takes_memory(self, node: ast.Call) -> bool:
        given = [*node.args, *(keyword.value for keyword in node.keywords)]
        terms = [self._scope.get(part.id) for part in given if isinstance(part, ast.Name)]
        return any(term is not None and term.kind.is_memory for term in terms)

    def _is_left_out(self, node: ast.stmt) -> bool:
        """Whether C leaves ``node`` out: calls of functions that are marked, alone or under conditions."""
        if isinstance(node, ast.If):
            pure = not any(isinstance(n, ast.Call) and self._takes_memory(n) for n in ast.walk(node.test))
            return pure and all(map(self._is_left_out, [*node.body, *node.orelse]))
        if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
            return False
        if not getattr(self._resolved(node.value.func), "node_only", False):
            return False
        self._check_order(node)
        return True

    def _for(self, node: ast.For) -> None:
        """A loop over a range of integers, whose variable nothing else gives a value."""
        call, target = node.iter, node.target
        if not (
            isinstance(call, ast.Call)
            and isinstance(target, ast.Name)
            and self._resolved(call.func) is range
            and len(call.args) in (1, 2)
            and not (call.keywords or node.orelse)
        ):
            raise self.refused(node, "a for loop over anything but a range of integers")
        inside = {id(part) for part in ast.walk(node)}
        for other in ast.walk(self._parsed):
            if not isinstance(other, ast.Name) or other.id != target.id or other is target:
                continue
            if isinstance(other.ctx, ast.Store) or id(other) not in inside:
                raise self.refused(other, f"the loop's variable {target.id} is used elsewhere")
        bounds = [self._as(self._number(bound), INTEGER, node) for bound in call.args]
        end = bounds[-1] if bounds[-1].code.isdigit() else self._temporary(bounds[-1], node)
        begin = bounds[0].value if len(bounds) == 2 else "0"
        own = self._local(target.id)
        self._line(f"for (int64_t {own} = {begin}; {own} < {end.value}; {own}++) {{")
        outer = self._scope.get(target.id)
        self._scope[target.id] = Term(own, INTEGER)
        self._declared[target.id] = INTEGER
        self._nested(node.body)
        del self._scope[target.id], self._declared[target.id]
        if outer is not None:
            raise self.refused(node, f"the loop's variable {target.id} is used elsewhere")
        self._line("}")

    def _needs_lines(self, node: ast.If) -> bool:
        """Whether something must be computed or declared before the if."""
        lines, temporaries = list(self._lines), self._temporaries
        self._truth(node.test)
        needed = len(self._lines) > len(lines)
        self._lines, self._temporaries = lines, temporaries
        return needed

    def _nested(self, body: Sequence[ast.stmt]) -> bool:
        indent = self._indent
        self._indent += "    "
        ended = self._block(body)
        self._indent = indent
        return ended

    def _annotated(self, node: ast.AnnAssign, said: str) -> None:
        assert node.value is not None
        if not isinstance(node.target, ast.Name):
            raise self.refused(node, "an assignment to something else than a variable")
        hint = eval(ast.unparse(node.annotation), self._function.__globals__)
        kind = kinds.of_annotation(hint)
        if kind is None:
            raise self.refused(node, f"a variable of the type {ast.unparse(node.annotation)}")
        self._declared.setdefault(node.target.id, kind)
        self._store(node.target, self._as(self._expression(node.value, kind), kind, node), said)

    def _assign(self, target: ast.expr, value: ast.expr, said: str) -> None:
        if isinstance(target, ast.Tuple):
            self._unpack(target, value, said)
            return
        wanted = self._declared.get(target.id) if isinstance(target, ast.Name) else REAL
        if isinstance(target, ast.Attribute):
            wanted = self._slot(target).kind
        self._store(target, self._expression(value, wanted), said)

    def _unpack(self, target: ast.Tuple, value: ast.expr, said: str) -> None:
        names = {n.id for n in ast.walk(target) if isinstance(n, ast.Name)}
        if isinstance(value, ast.Tuple):
            if len(value.elts) != len(target.elts):
                raise self.refused(target, "as many names as values")
            used = [n.id for v in value.elts[1:] for n in ast.walk(v) if isinstance(n, ast.Name)]
            terms = [
                self._expression(v, self._declared.get(getattr(t, "id", "")))
                for t, v in zip(target.elts, value.elts, strict=True)
            ]
            if names & set(used) or any(isinstance(t, ast.Attribute) for t in target.elts):
                terms = [self._temporary(term, value) for term in terms]
        else:
            whole = self._expression(value)
            named = {n.id for n in ast.walk(value) if isinstance(n, ast.Name)}
            if not whole.has_address or names & named:
                whole = self._temporary(whole, value)
            terms = list(self._parts(whole, target))
        if len(terms) != len(target.elts):
            raise self.refused(target, f"{len(target.elts)} names for {len(terms)} values")
        for i, (part, term) in enumerate(zip(target.elts, terms, strict=True)):
            if isinstance(part, ast.Tuple):
                raise self.refused(target, "a tuple in a tuple")
            if not (isinstance(part, ast.Name) and part.id == "_"):
                self._store(part, term, said if i == len(terms) - 1 else "")

    def _store(self, target: ast.expr, term: Term, said: str) -> None:
        if isinstance(target, ast.Subscript):
            self._line(f"{self._entry(target).code} = {self._as(term, REAL, target).value};", said)
            return
        if isinstance(target, ast.Attribute):
            slot = self._slot(target)
            self._line(f"{slot.code} = {self._as(term, slot.kind, target).value};", said)
            return
        if not isinstance(target, ast.Name):
            raise self.refused(target, "an assignment to something else than a variable")
        name = target.id
        kind = self._declared.get(name)
        if kind is None:
            kind = self._declared[name] = self._whole_kind(name, term.kind)
        term = self._as(term, kind, target)
        own, begin = self._local(name), ""
        if name not in self._scope and self._indent == INDENT:
            begin = f"{self._program.type_name(kind)} "
        elif name not in self._scope:  # declared at the beginning, since what follows the block may read it
            self._head.append(f"{INDENT}{self._program.declared(kind, own)};")
        self._scope[name] = Term(own, kind, has_address=True)
        self._line(f"{begin}{own} = {term.value};", said)

    def _slot(self, target: ast.Attribute) -> Term:
        """The slot of a memory that gets a value."""
        base = self._scope.get(target.value.id) if isinstance(target.value, ast.Name) else None
        if base is None or not base.kind.is_memory:
            raise self.refused(target, "an assignment to something else than a variable or a memory's slot")
        return self._attribute(target)

    def _whole_kind(self, name: str, kind: Kind) -> Kind:
        """Kind of a variable that is first given a value of ``kind``."""
        if kind is NOTHING:
            raise self.refused(
                self._parsed, f"{name} is None at first; annotate it, as in {name}: float | None"
            )
        return kind
