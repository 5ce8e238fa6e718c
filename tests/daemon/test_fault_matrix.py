"""Every fault that the daemon must survive, and the tests that show it.

The table is the index: a fault without a test, or a test that was renamed away, fails here. Faults of nodes,
sensors and buses are begun and ended by one rule in `test_every_fault`; the tests named beside look closer.
"""

import ast
from pathlib import Path

import pytest
from tests.daemon import test_every_fault

TESTS = Path(__file__).parents[1]

RULE = "daemon/test_every_fault.py::test_a_fault_is_survived_told_and_never_served"

FAULTS: dict[str, tuple[str, ...]] = {
    "node silent": (
        f"{RULE}[node silent]",
        "daemon/test_running_service.py::test_a_silent_node_is_marked_and_the_other_stays_valid",
    ),
    "node rebooting": (
        f"{RULE}[node rebooting]",
        "daemon/test_running_service.py::test_the_first_frame_after_a_reboot_is_never_served",
        "daemon/test_can_master.py::test_reboot_during_the_set_up_starts_it_over",
    ),
    "node replaced": (
        f"{RULE}[node replaced]",
        "daemon/test_running_service.py::test_a_node_that_comes_back_as_another_encoder_is_not_corrected",
    ),
    "preset, code sequence or scaling changed behind our back": (
        f"{RULE}[preset behind our back]",
        f"{RULE}[code sequence behind our back]",
        f"{RULE}[scaling behind our back]",
        (
            "daemon/test_running_service.py::"
            "test_an_encoder_that_another_tool_sets_while_it_runs_is_noticed_and_no_longer_corrected"
        ),
        "daemon/test_can_master_modes.py::test_write_of_another_master_takes_the_node_out_before_its_next_frame",
        "daemon/test_running_policy.py::test_no_reload_accepts_an_encoder_whose_own_zero_was_moved_in_service",
    ),
    "right model on the wrong joint": (
        "daemon/test_running_service.py::test_an_encoder_that_differs_is_served_raw_and_never_corrected",
        "daemon/test_service.py::test_one_model_on_two_joints_is_a_fault",
    ),
    "duplicate id": (
        f"{RULE}[node id taken]",
        (
            "daemon/test_running_faults.py::"
            "test_second_unit_with_the_same_node_id_takes_the_joint_out_until_it_is_gone"
        ),
    ),
    "wrong mapping": (
        f"{RULE}[wrong mapping]",
        "daemon/test_running_service.py::test_a_node_that_keeps_its_old_mapping_is_a_fault_and_never_served",
        "daemon/test_can_master_modes.py::test_mapping_that_is_changed_in_service_is_found_by_asking",
    ),
    "short and long frames": (
        f"{RULE}[short frames]",
        f"{RULE}[long frames]",
        "daemon/test_running_service.py::test_frames_of_another_length_are_never_decoded",
    ),
    "late frames": (
        "daemon/test_pipeline.py::test_frames_that_waited_on_a_stalled_link_have_the_age_of_their_own_sync",
        "daemon/test_pipeline.py::test_a_number_that_jumped_makes_no_later_frame_younger_than_its_arrival",
    ),
    "doubled frames": (
        f"{RULE}[doubled frames]",
        "daemon/test_pipeline_sources.py::test_doubled_frame_is_no_clash_and_refreshes_nothing_for_long",
        "daemon/test_pipeline.py::test_an_old_frame_that_comes_again_is_never_served",
    ),
    "frozen frames": (
        f"{RULE}[frozen frames]",
        "daemon/test_running_faults.py::test_frozen_frames_grow_old",
        "daemon/test_sequence_numbers.py::test_a_node_that_froze_before_it_came_into_service_is_never_valid",
    ),
    "heartbeat without process data": (
        f"{RULE}[heartbeat without process data]",
        "daemon/test_running_faults.py::test_heartbeat_without_process_data_is_stale",
    ),
    "process data without heartbeat": (
        f"{RULE}[process data without heartbeat]",
        "daemon/test_running_faults.py::test_process_data_without_heartbeat_are_not_believed",
    ),
    "storm of emergencies": (
        f"{RULE}[storm of emergencies]",
        "daemon/test_running_faults.py::test_storm_of_emergencies_leaves_the_other_joint_valid",
        "daemon/test_can_master_modes.py::test_storm_of_emergencies_is_one_log_line_and_its_end_tells_how_many",
    ),
    "temperature broken": (
        f"{RULE}[temperature broken]",
        f"{RULE}[temperature gone]",
        "daemon/test_running_service.py::test_temperature_outside_of_model_or_sensor_is_not_corrected",
        (
            "daemon/test_pipeline.py::"
            "test_no_correction_for_a_broken_temperature_is_served_once_the_sensor_is_good_again"
        ),
    ),
    "temperature frozen": (
        f"{RULE}[temperature frozen]",
        "daemon/test_temperature_watch.py::test_a_value_that_never_changes_is_frozen_and_one_that_moves_a_bit_is_not",
    ),
    "temperature jumping": (
        f"{RULE}[temperature jumping]",
        "daemon/test_serving_policy.py::test_a_temperature_that_jumps_is_a_reason_of_its_own",
    ),
    "SYNC lost": (
        f"{RULE}[SYNC lost]",
        "daemon/test_pipeline.py::test_silence_on_the_whole_bus_is_marked_by_the_tick",
    ),
    "bus flooded": (
        f"{RULE}[bus flooded]",
        "daemon/test_running_faults.py::test_foreign_traffic_disturbs_nothing",
        "daemon/test_can_bus.py::test_full_inbox_drops_the_oldest_frame_and_counts",
        "daemon/test_socketcan_link.py::test_frames_that_the_kernel_dropped_are_counted_before_the_frames_behind_them",
    ),
    "bus lost": (
        f"{RULE}[bus lost]",
        "daemon/test_service_life.py::test_a_bus_that_is_lost_takes_its_joints_out_and_comes_back",
        "daemon/test_socketcan_link.py::test_interface_that_goes_down_or_is_removed_is_opened_again",
    ),
    "model file replaced by garbage during a reload": (
        "daemon/test_reload_refused.py::test_what_is_refused_leaves_all_as_it_was_and_says_why_until_a_good_one_comes",
    ),
    "300 connections": (
        (
            "daemon/test_modbus_limits.py::"
            "test_three_hundred_connections_are_held_to_the_limit_and_the_first_are_served"
        ),
        "daemon/test_hostile_clients.py::test_no_crowd_of_clients_takes_a_joint_or_a_good_client_down",
    ),
    "slow readers": (
        "daemon/test_modbus_server.py::test_a_client_that_does_not_read_is_not_read_from_and_gets_every_answer_later",
        "daemon/test_hostile_clients.py::test_no_crowd_of_clients_takes_a_joint_or_a_good_client_down",
    ),
    "half-open connections": (
        "daemon/test_modbus_server.py::test_a_silent_connection_is_closed_after_the_idle_time",
        "daemon/test_modbus_limits.py::test_a_client_that_resets_or_leaves_half_a_request_frees_its_place",
    ),
    "byte-by-byte requests": (
        "daemon/test_modbus_server.py::test_a_request_that_arrives_byte_by_byte_is_answered",
    ),
    "30 pipelined requests": (
        "daemon/test_modbus_limits.py::test_thirty_pipelined_requests_of_all_kinds_are_answered_in_order",
    ),
    "garbage": (
        "daemon/test_modbus_limits.py::test_random_streams_of_many_clients_leave_the_server_as_it_was",
        "daemon/test_hostile_clients.py::test_no_crowd_of_clients_takes_a_joint_or_a_good_client_down",
    ),
    "random function codes": (
        "fuzz/test_fuzz.py::test_modbus_streams_are_answered_from_the_image_and_do_no_more_than_the_peer_may",
    ),
    "TLS without or with a foreign certificate": (
        "daemon/test_modbus_tls.py::test_a_missing_foreign_or_expired_certificate_is_refused_and_logged_once",
    ),
    "clock set back": (
        "test_architecture.py::test_nothing_but_dates_is_read_from_a_clock_that_may_be_set_back",
        "daemon/test_service_life.py::test_an_image_of_a_pipeline_that_stands_still_is_soon_served_no_more",
        (
            "daemon/test_frames_that_waited.py::"
            "test_a_stall_makes_no_frame_younger_also_when_the_wall_clock_is_set_meanwhile"
        ),
        "daemon/test_running_faults.py::test_wall_clock_that_is_set_back_moves_no_deadline",
        "daemon/test_temperature_watch.py::test_a_clock_set_back_leaves_a_past_due_calibration_past_due",
    ),
    "disk full": (
        "daemon/test_recorder.py::test_a_disk_that_fills_in_service_stops_the_recording_and_no_joint",
        "daemon/test_recorder.py::test_a_full_disk_stops_the_recording_and_room_lets_it_go_on",
        "daemon/test_presets.py::test_a_disk_that_refuses_keeps_the_old_presets_and_says_so",
        "daemon/test_commands.py::test_a_preset_is_in_force_only_when_it_is_on_the_disk",
    ),
    "position elsewhere": (
        f"{RULE}[position elsewhere and back]",
        "daemon/test_position.py::test_a_preset_that_stays_is_never_believed_however_consistent",
    ),
    "SIGTERM": (
        "daemon/test_service_life.py::test_sigterm_says_stopping_ends_connections_and_leaves_nothing",
        "daemon/test_service_life.py::test_no_angle_is_served_any_more_once_the_stop_has_begun",
    ),
    "SIGKILL and restart": (
        "daemon/test_hostile_clients.py::test_a_daemon_that_was_killed_starts_on_its_port_and_serves_again",
    ),
    "one line says what began, one when it ended": (
        "daemon/test_modbus_limits.py::test_trouble_has_a_line_at_its_begin_one_a_minute_and_one_when_it_is_over",
        "daemon/test_socketcan_link.py::test_socketcan_error_passive_shows_until_the_controller_is_well_again",
        "daemon/test_outage.py::test_an_outage_is_a_line_at_its_begin_and_one_at_its_end_with_the_time_of_each_reason",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_has_tests_that_exist(fault: str) -> None:
    assert FAULTS[fault]
    for test in FAULTS[fault]:
        file, _, name = test.partition("::")
        name, _, case = name.partition("[")
        tree = ast.parse((TESTS / file).read_text("utf-8"))
        assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, test
        assert not case or case[:-1] in test_every_fault.FAULTS, test


def test_every_fault_of_the_rule_is_in_the_table() -> None:
    listed = {test for tests in FAULTS.values() for test in tests}
    assert {f"{RULE}[{name}]" for name in test_every_fault.FAULTS} <= listed
