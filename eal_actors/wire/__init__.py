"""The network: robots of other processes and machines, over zenoh.

The life of a remote call:
1. `rpc/client/`: a ResourceHandle puts the call into the `CallQueue` of its `RemoteRobot`; a `Sender` sends it.
2. `format/`: `keys` and `messages` make of it a key, an envelope and a payload; `transport` sends them.
3. `rpc/server/`: `RobotHost` receives it, `RobotServer` decodes it, `Admission` checks age, lease and order, and the
   call goes to the resource's actor. The `Outbox` sends the reply.
4. `rpc/client/`: `CallQueue` finds the call by its number and resolves its future.

`security/` holds certificates and access control, `streams/` the values that a resource publishes.
"""
