"""Kernels are launched faster with arrays that they have had before.

At every launch Taichi 1.7 looks at each array anew: at its kind, for the code that was compiled for
it, and at its type. A time step launches some ten kernels with up to twenty arrays, and that takes
as long as a small kernel does. Here a kernel remembers what Taichi found for the arrays of a
launch. Whatever is not as expected goes Taichi's own way.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

MOST_REMEMBERED = 32
"""Launches with different arrays that a kernel remembers."""


def shorten() -> None:
    """Let kernels remember their launches, where Taichi is as expected."""
    from taichi.lang import kernel_impl

    kind = kernel_impl.Kernel
    expected = ("ensure_compiled", "launch_kernel", "construct_kernel_ret")
    if not hasattr(kind, "launches") and all(hasattr(kind, name) for name in expected):
        kind.launches = None
        kind.__call__ = _remembering(kind.__call__)


_all: list[Launches] = []


def forget() -> None:
    """Forget all launches, as before Taichi starts again: they hold on to its program."""
    for launches in _all:
        launches.known.clear()


def _remembering(call: Callable[..., Any]) -> Callable[..., Any]:
    def launch(kernel: Any, *arguments: Any, **more: Any) -> Any:
        if kernel.launches is None:
            kernel.launches = Launches(kernel)
            _all.append(kernel.launches)
        runtime = kernel.runtime
        if more or runtime.target_tape or runtime.fwd_mode_manager or not kernel.launches.possible:
            return call(kernel, *arguments, **more)
        key = kernel.launches.key(arguments)
        known = kernel.launches.known.get(key)
        if known and known.has_its_arrays:
            return known.again(arguments)
        result = call(kernel, *arguments)
        kernel.launches.remember(key, arguments)
        return result

    return launch


class Launches:
    """The launches that a kernel remembers.

    Attributes:
        possible: Whether it has arguments of the usual kinds alone.
        known: The launches by their keys.
    """

    def __init__(self, kernel: Any) -> None:
        from taichi.lang import kernel_impl as taichi

        self._kernel = kernel
        self.possible: bool = not kernel.has_print
        self.known: dict[tuple[int, ...], Launch] = {}
        self._templates: list[int] = []
        self._arrays: list[int] = []
        self._packs: list[int] = []
        self._numbers: list[tuple[int, str, Callable[[Any], Any]]] = []
        for i, argument in enumerate(kernel.arguments):
            kind = argument.annotation
            if isinstance(kind, taichi.template):
                self._templates.append(i)
            elif isinstance(kind, taichi.ndarray_type.NdarrayType):
                self._arrays.append(i)
            elif isinstance(kind, taichi.ArgPackType):
                self._packs.append(i)
            elif id(kind) in taichi.primitive_types.real_type_ids:
                self._numbers.append((i, "set_arg_float", float))
            elif id(kind) in taichi.primitive_types.integer_type_ids:
                signed = taichi.is_signed(taichi.cook_dtype(kind))
                self._numbers.append((i, "set_arg_int" if signed else "set_arg_uint", int))
            else:
                self.possible = False

    def key(self, arguments: tuple[Any, ...]) -> tuple[int, ...]:
        """What tells launches apart: their templates and arrays."""
        values = [arguments[i] for i in self._templates]
        key = [value if isinstance(value, int) else id(value) for value in values]
        key += [id(arguments[i]) for i in self._arrays]
        for i in self._packs:
            key.append(id(arguments[i]))
            key += map(id, _members(arguments[i]))
        return tuple(key)

    def remember(self, key: tuple[int, ...], arguments: tuple[Any, ...]) -> None:
        """Remember a launch, if all its arrays are on the device and have no gradients."""
        from taichi.lang._ndarray import Ndarray

        arrays = [arguments[i] for i in self._arrays]
        packs = [arguments[i] for i in self._packs]
        members = [member for pack in packs for member in _members(pack)]
        if not all(isinstance(a, Ndarray) and a.grad is None for a in arrays + members):
            return
        given = [i for i in range(len(arguments)) if i not in self._templates]
        slots = {i: (slot,) for slot, i in enumerate(given)}
        bound = [("set_arg_ndarray", slots[i], arguments[i].arr) for i in self._arrays]
        bound += [
            ("set_arg_argpack", slots[i], arguments[i]._ArgPack__argpack) for i in self._packs
        ]
        bound += [("set_arg_ndarray", (len(given) + n,), a.arr) for n, a in enumerate(members)]
        numbers = [(i, name, slots[i], kind) for i, name, kind in self._numbers]
        templates = [arguments[i] for i in self._templates]
        if len(self.known) >= MOST_REMEMBERED:
            self.known.clear()
        compiled = self._kernel.compiled_kernels[self._kernel.ensure_compiled(*arguments)]
        self.known[key] = Launch(
            self._kernel, compiled, bound, numbers, templates, arrays + packs + members
        )


def _members(pack: Any) -> Any:
    return pack._ArgPack__entries.values()


class Launch:
    """A launch of a kernel with certain templates and arrays, and any numbers."""

    def __init__(
        self,
        kernel: Any,
        compiled: Any,
        bound: list[tuple[str, tuple[int], Any]],
        numbers: list[tuple[int, str, tuple[int], Callable[[Any], Any]]],
        templates: list[Any],
        arrays: list[Any],
    ) -> None:
        self._kernel = kernel
        self._program = kernel.runtime.prog
        self._new_context = compiled.make_launch_context
        self._bound = bound
        self._numbers = numbers
        self._templates = templates  # kept, so that no other one gets their ids
        self._arrays = [weakref.ref(array) for array in arrays]
        program = self._program
        self._code = program.compile_kernel(program.config(), program.get_device_caps(), compiled)

    @property
    def has_its_arrays(self) -> bool:
        """Whether none of its arrays is gone, and another one in its place."""
        return all(array() is not None for array in self._arrays)

    def again(self, arguments: tuple[Any, ...]) -> Any:
        """Launch the kernel with the numbers among these arguments; returns what it returns."""
        context, kernel = self._new_context(), self._kernel
        for name, slot, value in self._bound:
            getattr(context, name)(slot, value)
        for i, name, slot, kind in self._numbers:
            getattr(context, name)(slot, kind(arguments[i]))
        self._program.launch_kernel(self._code, context)
        if kernel.return_type is None:
            return None
        self._program.synchronize()
        values = [
            kernel.construct_kernel_ret(context, kind, (n,))
            for n, kind in enumerate(kernel.return_type)
        ]
        return values[0] if len(values) == 1 else values
