"""Two idioms of control flow that XLA's CPU compiler rewards. Both are loops of at most one turn.

A loop's buffers are updated in place and stored when it ends. A condition's are copied; and a value that is used in
many places without a loop around it is often computed anew in each of them.
"""

import jax
from jax import lax


def run_if(predicate, function, otherwise):
    """`function(otherwise)` if a condition holds, else `otherwise`.

    Args:
      predicate: bool scalar.
      function: takes and returns a pytree like `otherwise`.
      otherwise: pytree of arrays.

    Returns:
      pytree like `otherwise`.
    """
    return lax.while_loop(lambda s: s[0], lambda s: (False, function(s[1])), (predicate, otherwise))[1]


def stored(truth, function):
    """The value of `function()`, computed once and kept.

    Args:
      truth: bool scalar, always True, in a way that the compiler cannot tell.
      function: takes nothing, returns a pytree of arrays.

    Returns:
      what `function` returns.
    """
    blank = jax.tree.map(lambda x: jax.numpy.zeros(x.shape, x.dtype), jax.eval_shape(function))
    return run_if(truth, lambda _: function(), blank)
