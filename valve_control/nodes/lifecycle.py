"""Managed nodes that look after themselves unless they are told not to."""

from typing import Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from valve_control.nodes.loop import Worker


class Managed(LifecycleNode, Worker):
    """Node with the states unconfigured, inactive and active.

    ``open`` and ``close`` make and destroy publishers and subscriptions, ``begin`` and ``end`` bracket the
    time in which the node works.
    """

    def __init__(self, name: str, **options: Any) -> None:
        self.working = False
        super().__init__(name, **options)
        # A transition that does not exist from the present state would end the process otherwise.
        answer = self._service_change_state.callback

        def guarded(request: Any, response: Any) -> Any:
            try:
                return answer(request, response)
            except RCLError:
                wanted = request.transition.label or request.transition.id
                self.get_logger().warning(
                    f"transition {wanted} refused, the node is {self._state_machine.current_state[1]}"
                )
                response.success = False
                return response

        self._service_change_state.callback = guarded

    def autostart(self) -> None:
        """Configure and activate."""
        self.trigger_configure()
        self.trigger_activate()

    def open(self) -> None:
        """Make publishers and subscriptions."""

    def close(self) -> None:
        """Destroy them."""

    def begin(self) -> None:
        """Start to work."""

    def end(self) -> None:
        """Stop to work."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition from unconfigured to inactive."""
        self.open()
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition from inactive to active."""
        self.begin()
        self.working = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition from active to inactive."""
        self.working = False
        self.end()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition from inactive to unconfigured."""
        self.close()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition to the end, from any state."""
        if self.working:
            self.on_deactivate(state)
        return TransitionCallbackReturn.SUCCESS

    def finish(self) -> None:
        """Shut down in order."""
        if self.working:
            self.trigger_shutdown()
