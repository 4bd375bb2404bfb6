"""The feed that the axes really have along a path, where it dips, and how much metal that adds."""

from ebamcheck.kinematics.limits import DrivenPath as DrivenPath
from ebamcheck.kinematics.limits import polyline_path as polyline_path
from ebamcheck.kinematics.limits import program_path as program_path
from ebamcheck.kinematics.profile import FeedProfile as FeedProfile
from ebamcheck.kinematics.profile import feed_profile as feed_profile
from ebamcheck.kinematics.profile import polyline_profile as polyline_profile
from ebamcheck.kinematics.profile import side_by_side as side_by_side
