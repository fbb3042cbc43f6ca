# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Makes managed nodes (lifecycle) that configure and activate themselves unless told not to."""

from typing import Any

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from valve_control.nodes.loop import Worker
from valve_control.nodes.rclpy_internals import RCLError
from valve_control.nodes.services import Unwatched


class Managed(LifecycleNode, Worker):
    """Lifecycle node with the states unconfigured, inactive and active.

    ``open`` creates publishers and subscriptions, which ``close`` destroys. ``begin`` and ``end`` bracket the
    time in which the node works.
    """

    def __init__(self, name: str, **options: Any) -> None:
        self.working = self.configured = False
        self.halted = ""  # why the node has deactivated itself; "": it has not
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
        """Create publishers and subscriptions."""

    def close(self) -> None:
        """Destroy the publishers and polled subscriptions that were created since ``open``."""
        for publisher in {*self.publishers} - self._lasting:
            self.destroy_publisher(publisher)
        for subscription in {*self.subscriptions} - self._lasting:
            if isinstance(subscription.callback_group, Unwatched):
                self.destroy_subscription(subscription)

    def begin(self) -> None:
        """Start working."""

    def end(self) -> None:
        """Stop working."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition from unconfigured to inactive."""
        self._lasting = {*self.publishers, *self.subscriptions}
        self.open()
        self.configured = True
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition from inactive to active."""
        self.halted = ""
        self.begin()
        self.working = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition from active to inactive."""
        self.working = False
        self.end()
        return TransitionCallbackReturn.SUCCESS

    def halt(self, reason: str) -> None:
        """Deactivate the node itself; the diagnostics give the ``reason`` until it is active again."""
        self.halted = reason
        self.get_logger().error(reason)
        self.trigger_deactivate()

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition from inactive to unconfigured."""
        self.close()
        self.configured = False
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition from any state to finalized."""
        if self.working:
            self.on_deactivate(state)
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Destroy the state machine too, which rclpy leaves alone.

        It holds the node, and with it the participant, whose threads would run on while the process ends:
        "pure virtual method called".
        """
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    def finish(self) -> None:
        """Shut down from whatever state the node is in."""
        if self.working:
            self.trigger_shutdown()
