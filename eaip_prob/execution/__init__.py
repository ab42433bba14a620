"""From a prediction to the robot's motion: is the plan safe, how is it followed, and what does the partner do."""

from eaip_prob.execution.following import MotionLimits
from eaip_prob.execution.known_path import known_path
from eaip_prob.execution.obstacle import Obstacle, clearance
from eaip_prob.execution.partner import PartnerReport, PartnerState, PartnerWatch
from eaip_prob.execution.plan import Plan, RobotCommand
from eaip_prob.execution.running import Execution, ExecutionState, Outcome
from eaip_prob.execution.safety import SafetyRules, Verdict, check_plan, collision_risk

__all__ = [
    "Execution",
    "ExecutionState",
    "MotionLimits",
    "Obstacle",
    "Outcome",
    "PartnerReport",
    "PartnerState",
    "PartnerWatch",
    "Plan",
    "RobotCommand",
    "SafetyRules",
    "Verdict",
    "check_plan",
    "clearance",
    "collision_risk",
    "known_path",
]
