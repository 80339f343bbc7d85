// Every entry of a vehicle's configuration, for vehicle_config.cpp alone.
#pragma once

#include <convoy/components/vehicle_config.hpp>

namespace convoy {

// One description of every entry serves reading and writing: visit(element, attribute, value).
template <class Visitor>
void describe(const char* element, Impairment& i, Visitor& visit) {
  visit(element, "loss", i.loss);
  visit(element, "duplicate", i.duplicate);
  visit(element, "delay_s", i.delay_s);
  visit(element, "jitter_s", i.jitter_s);
  visit(element, "reorder", i.reorder);
  visit(element, "rate_bytes_per_s", i.rate_bytes_per_s);
  visit(element, "queue_s", i.queue_s);
  visit(element, "partitions", i.partitions);
  visit(element, "seed", i.seed);
}

template <class Visitor>
void describe(CameraConfig& c, Visitor& visit) {
  visit("camera", "domain", c.domain);
  visit("camera", "lock_step", c.lock_step);
  visit("camera", "interfaces", c.interfaces);
  visit("camera", "wait_s", c.wait_s);
  visit("camera", "gps", c.gps);
  visit("camera", "features", c.features);
  visit("camera", "new_features", c.new_features);
  MonocularParams& m = c.slam;
  visit("camera", "sigma_pixel", m.sigma_pixel);
  visit("camera", "sigma_along_per_sqrt_m", m.sigma_along_per_sqrt_m);
  visit("camera", "sigma_along_per_sqrt_rad", m.sigma_along_per_sqrt_rad);
  visit("camera", "sigma_across_per_sqrt_m", m.sigma_across_per_sqrt_m);
  visit("camera", "sigma_heading_per_sqrt_m", m.sigma_heading_per_sqrt_m);
  visit("camera", "sigma_heading_per_sqrt_rad", m.sigma_heading_per_sqrt_rad);
  visit("camera", "sigma_heading_per_sqrt_s", m.sigma_heading_per_sqrt_s);
  visit("camera", "sigma_vertical_per_sqrt_m", m.sigma_vertical_per_sqrt_m);
  visit("camera", "sigma_tilt_per_sqrt_m", m.sigma_tilt_per_sqrt_m);
  visit("camera", "distance_scale", m.distance_scale);
  visit("camera", "angle_scale", m.angle_scale);
  visit("camera", "sigma_scale", m.sigma_scale);
  visit("camera", "sigma_yaw_bias_radps", m.sigma_yaw_bias_radps);
  visit("camera", "sigma_yaw_bias_walk_per_sqrt_s", m.sigma_yaw_bias_walk_per_sqrt_s);
  visit("camera", "max_odometry_gap_s", m.max_odometry_gap_s);
  visit("camera", "max_landmark_distance_m", m.max_landmark_distance_m);
  visit("camera", "max_landmarks", m.max_landmarks);
  visit("camera", "min_sightings", m.min_sightings);
  visit("camera", "max_sigma_m", m.max_sigma_m);
  visit("camera", "segment_length_m", m.segment_length_m);
  visit("camera", "min_batch", m.min_batch);
  visit("camera", "max_segment_length_m", m.max_segment_length_m);
  visit("camera", "trail_spacing_m", m.trail_spacing_m);
}

template <class G, class Visitor>
void describe(VehicleConfig<G>& c, Visitor&& visit) {
  constexpr bool in_space = G::Dim == 3;
  VehicleParams<G>& v = c.vehicle;
  visit("vehicle", "id", v.id);
  visit("vehicle", "state_folder", v.state_folder);
  visit("vehicle", "journal", v.journal);
  visit("vehicle", "first_epoch", c.first_epoch);
  visit("vehicle", "output_folder", c.output_folder);
  visit("vehicle", "roster", v.submaps.limits.roster);
  visit("vehicle", "live_period_s", v.live_period_s);
  visit("vehicle", "step_period_s", v.step_period_s);
  visit("vehicle", "searches_per_step", v.searches_per_step);

  visit("dds", "domain", c.dds.domain);
  visit("dds", "profile", c.dds.profile_file);
  visit("dds", "participant_profile", c.dds.participant_profile);
  visit("dds", "interfaces", c.dds.interface_whitelist);
  visit("dds", "peers", c.dds.initial_peers);
  visit("dds", "discovery_servers", c.dds.discovery_servers);
  visit("dds", "max_queued_messages", c.dds.max_queued_messages);
  visit("dds", "security", c.dds.security_folder);

  describe("impairment", c.impairment.received, visit);
  describe("impairment_sent", c.impairment.sent, visit);

  RangeBearingEkfParams& f = c.front_end;
  visit("front_end", "sigma_along_per_sqrt_m", f.sigma_along_per_sqrt_m);
  visit("front_end", "sigma_along_per_sqrt_rad", f.sigma_along_per_sqrt_rad);
  visit("front_end", "sigma_across_per_sqrt_m", f.sigma_across_per_sqrt_m);
  visit("front_end", "sigma_heading_per_sqrt_m", f.sigma_heading_per_sqrt_m);
  visit("front_end", "sigma_heading_per_sqrt_rad", f.sigma_heading_per_sqrt_rad);
  visit("front_end", "sigma_heading_per_sqrt_s", f.sigma_heading_per_sqrt_s);
  if constexpr (in_space) {
    visit("front_end", "sigma_vertical_per_sqrt_m", f.sigma_vertical_per_sqrt_m);
    visit("front_end", "sigma_tilt_per_sqrt_m", f.sigma_tilt_per_sqrt_m);
    visit("front_end", "sigma_elevation_rad", f.sigma_elevation_rad);
  }
  visit("front_end", "distance_scale", f.distance_scale);
  visit("front_end", "angle_scale", f.angle_scale);
  visit("front_end", "sigma_range_m", f.sigma_range_m);
  visit("front_end", "sigma_range_share", f.sigma_range_share);
  visit("front_end", "sigma_bearing_rad", f.sigma_bearing_rad);
  visit("front_end", "min_sighting_interval_s", f.min_sighting_interval_s);
  visit("front_end", "gate", f.gate);
  visit("front_end", "max_rejections", f.max_rejections);
  visit("front_end", "min_range_m", f.min_range_m);
  visit("front_end", "max_range_m", f.max_range_m);
  visit("front_end", "max_odometry_gap_s", f.max_odometry_gap_s);
  visit("front_end", "min_sightings", f.min_sightings);
  visit("front_end", "min_parallax_rad", f.min_parallax_rad);
  visit("front_end", "max_sigma_m", f.max_sigma_m);
  visit("front_end", "max_remembered", f.max_remembered);
  visit("front_end", "nis_confidence", f.nis_confidence);
  visit("front_end", "nis_window", f.nis_window);
  visit("front_end", "segment_length_m", f.segment_length_m);
  visit("front_end", "min_batch", f.min_batch);
  visit("front_end", "max_segment_length_m", f.max_segment_length_m);
  visit("front_end", "trail_spacing_m", f.trail_spacing_m);

  DriftParams<G>& d = v.drift;
  visit("drift", "model", d.model);
  visit("drift", "gamma", d.gamma);
  visit("drift", "rate_x_m2_per_m", d.rate[0]);
  visit("drift", "rate_y_m2_per_m", d.rate[1]);
  if constexpr (in_space) {
    visit("drift", "rate_z_m2_per_m", d.rate[2]);
    visit("drift", "rate_roll_rad2_per_m", d.rate[3]);
    visit("drift", "rate_pitch_rad2_per_m", d.rate[4]);
    visit("drift", "tilt_sigma_rad", d.persistent.tilt_rad);
    visit("drift", "height_sigma_m", d.persistent.height_m);
    visit("drift", "correlation_m", d.persistent.correlation_m);
  }
  visit("drift", "rate_theta_rad2_per_m", d.rate[G::Dof - 1]);
  visit("drift", "landmark_inflation", d.landmark_inflation);
  visit("drift", "scale_sigma", d.persistent.scale);
  visit("drift", "heading_sigma_rad_per_m", d.persistent.heading_rad_per_m);

  AssociationParams& a = v.association;
  visit("association", "compatibility", a.constraints.compatibility);
  visit("association", "loop", a.constraints.loop);
  visit("association", "distance", a.constraints.distance);
  visit("association", "heading", a.constraints.heading);
  visit("association", "min_distance_m", a.constraints.min_distance_m);
  visit("association", "method", a.method);
  visit("association", "max_nodes", a.max_nodes);
  visit("association", "max_candidates", a.max_candidates);
  visit("association", "max_landmarks", a.max_landmarks);
  visit("association", "min_pairings", a.min_pairings);
  visit("association", "residual", a.residual);
  visit("association", "pairing", a.pairing);
  visit("association", "separation", a.separation);
  visit("association", "max_false_alarms", a.max_false_alarms);
  visit("association", "max_runner_up_share", a.max_runner_up_share);
  visit("association", "min_runner_up_false_alarms", a.min_runner_up_false_alarms);
  visit("association", "alignment_gate", a.alignment.gate);
  visit("association", "min_odds", a.alignment.min_odds);
  visit("association", "density_radius_m", a.alignment.density_radius_m);
  visit("association", "max_proposals", a.alignment.max_proposals);
  visit("association", "max_votes", a.alignment.max_votes);
  visit("association", "max_chance_places", a.max_chance_places);
  visit("association", "max_doubt", a.max_doubt);
  visit("association", "min_similarity", a.min_similarity);

  SubmapManagerParams& s = v.submaps;
  visit("map", "backend", s.backend);
  visit("map", "period_s", s.map_period_s);
  visit("map", "exact_share", s.exact_share);
  visit("map", "min_pairings", s.selection.min_pairings);
  visit("map", "residual", s.selection.residual);
  visit("map", "map_residual", s.selection.map_residual);
  visit("map", "max_runner_up_share", s.selection.max_runner_up_share);
  visit("map", "min_confirmed", s.selection.min_confirmed);
  visit("map", "scale_slack", s.selection.slack.scale);
  visit("map", "heading_slack_rad_per_m", s.selection.slack.heading_rad_per_m);
  visit("map", "fix_correlation_s", s.selection.fix_correlation_s);
  visit("map", "fix_residual", s.selection.fix_residual);
  visit("map", "common_frame_is_enu", s.selection.common_frame_is_enu);
  visit("map", "encounter_period_s", s.encounter_period_s);
  visit("map", "reference_vehicle", s.selection.reference);
  visit("map", "stale_peer_s", s.stale_peer_s);

  visit("repair", "digest_period_s", s.repair.digest_period_s);
  visit("repair", "digest_idle_s", s.repair.digest_idle_s);
  visit("repair", "max_chains", s.repair.max_chains);
  visit("repair", "grace_s", s.repair.grace_s);
  visit("repair", "backoff_min_s", s.repair.backoff_min_s);
  visit("repair", "backoff_max_s", s.repair.backoff_max_s);
  visit("repair", "relay_delay_s", s.repair.relay_delay_s);
  visit("repair", "max_ranges", s.repair.max_ranges);
  visit("repair", "asks_per_s", s.repair.asks_per_s);
  visit("repair", "answers_per_s", s.repair.answers_per_s);
  visit("repair", "resend_s", s.repair.resend_s);
  visit("repair", "batch_limit", s.repair.batch_limit);
  visit("repair", "requests_per_s", s.repair.requests_per_s);
  visit("repair", "max_answers", s.repair.max_answers);
  visit("repair", "lost_after_s", s.repair.lost_after_s);
  visit("repair", "seed", s.seed);

  visit("budget", "bytes_per_s", v.budget.bytes_per_s);
  visit("budget", "burst_s", v.budget.burst_s);
  visit("budget", "batch_limit", v.budget.batch_limit);
  visit("budget", "max_waiting", v.budget.max_waiting);

  visit("peers", "messages_per_s", s.peers.messages_per_s);
  visit("peers", "burst", s.peers.burst);
  visit("peers", "quarantine_s", s.peers.quarantine_s);
  visit("peers", "max_peers", s.peers.max_peers);
  visit("peers", "forget_after_s", s.peers.forget_after_s);
  visit("peers", "max_chains_per_vehicle", s.limits.max_chains_per_vehicle);
  visit("peers", "max_facts_per_vehicle", s.limits.max_facts_per_vehicle);
  visit("peers", "rival_s", s.rival_s);

  visit("watchdog", "deaf_s", v.watchdog.deaf_s);
  visit("watchdog", "mute_s", v.watchdog.mute_s);
  visit("watchdog", "lonely_s", v.watchdog.lonely_s);
  visit("watchdog", "pause_s", v.watchdog.pause_s);
  visit("watchdog", "max_pause_s", v.watchdog.max_pause_s);

  visit("sensors", "file", c.sensors.file);
  visit("sensors", "rate", c.sensors.rate);
  visit("sensors", "start_unix_s", c.sensors.start_unix_s);
  visit("vehicle", "mark_x_m", v.mark[0]);
  visit("vehicle", "mark_y_m", v.mark[1]);
  visit("sensors", "encounters", c.sensors.encounters);
  visit("sensors", "fix_lever_x_m", c.sensors.fix_lever[0]);
  visit("sensors", "fix_lever_y_m", c.sensors.fix_lever[1]);
  if constexpr (in_space) {
    visit("vehicle", "mark_z_m", v.mark[2]);
    visit("sensors", "fix_lever_z_m", c.sensors.fix_lever[2]);
    describe(c.camera, visit);
  }
}

}  // namespace convoy
