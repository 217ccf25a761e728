//! Tests of nodes that appear, leave and restart, and of the bridge's own node.

use super::rig::*;

#[test]
fn a_new_node_s_info_is_requested_and_sent_to_all_stations() {
    let mut rig = Rig::new(vec![Simulated::new(42, 0)]);
    rig.run_ms(1500);
    let infos = infos(&rig.sent_messages());
    assert_eq!(infos.len(), 1);
    assert_eq!(
        (infos[0].0, crate::message::name(&infos[0].1.name)),
        (42, "org.example.node42".into())
    );
    assert_eq!((infos[0].1.hw_version_major, infos[0].1.hw_version_minor), (3, 4));
    rig.run_ms(20_000);
    assert_eq!(rig.node().info_requests, 1);
}

/// Its uptime is 0 in both statuses. Otherwise the bridge would show a value that the restart has
/// undone.
#[test]
fn a_restart_within_the_first_second_of_a_node_is_detected_by_the_transfer_id() {
    let mut rig = Rig::with_node(1);
    rig.list(42);
    rig.run_ms(100);
    rig.node().parameters[0].value = Value::Integer(77);
    rig.node().uptime_s = 0;
    rig.sent_messages();
    rig.run_ms(1000);
    assert_eq!(texts(&rig.sent_messages()), ["Node 42 has restarted"]);
    rig.read_at(0);
    rig.run_ms(100);
    assert_eq!(rig.parameters()[0].1, Number::Int32(77));
    // The bus repeats a frame whose end is disturbed.
    let (now, frame) = (rig.now, rig.node().status());
    for later in [0, 1] {
        rig.bridge.frame(now + Duration::from_millis(later), &frame);
    }
    rig.run_ms(10);
    assert_eq!(texts(&rig.sent_messages()), [] as [String; 0]);
}

#[test]
fn infos_are_requested_again_when_the_bus_is_back() {
    let mut rig = Rig::with_node(3);
    rig.list(42);
    rig.run_ms(100);
    rig.node().parameters.truncate(2);
    rig.sent_messages();
    rig.bridge.bus_is_back();
    rig.read_at(1);
    rig.run_ms(100);
    let sent = rig.sent_messages();
    assert_eq!(infos(&sent).len(), 1);
    assert!(
        sent.iter()
            .any(|(_, content)| matches!(content, Content::Parameter { count: 2, index: 1, .. }))
    );
}

#[test]
fn a_node_is_offline_after_five_seconds_and_reported_once() {
    let mut rig = Rig::with_node(0);
    rig.node().is_silent = true;
    // The node's last status came at 1 s.
    rig.run_ms(4499);
    assert!(texts(&rig.sent_messages()).is_empty());
    rig.run_ms(20_000);
    assert_eq!(texts(&rig.sent_messages()), ["Node 42 is offline"]);
    rig.node().is_silent = false;
    rig.run_ms(1500);
    assert_eq!(
        infos(&rig.sent_messages()).len(),
        1,
        "the bridge must request the information of a node that returns"
    );
}

#[test]
fn unanswered_info_requests_become_less_frequent() {
    let mut rig = Rig::new(vec![Simulated::new(42, 0)]);
    rig.node().lose_every = Some(1);
    rig.run_ms(120_000);
    assert!((10..30).contains(&rig.node().requests), "{}", rig.node().requests);
    rig.node().lose_every = None;
    rig.run_ms(61_000);
    assert_eq!(infos(&rig.sent_messages()).len(), 1);
}

#[test]
fn infos_are_repeated_at_a_low_rate_and_sent_to_new_stations() {
    let mut rig = Rig::with_node(0);
    rig.run_ms(121_000);
    assert_eq!(infos(&rig.sent_messages()).len(), 2);
    rig.bridge.joined(rig.now, 9);
    rig.run_ms(1);
    assert!(
        matches!(rig.posts[0].1, Post::Message { to: To::One(9), class: Class::Answer, .. }),
        "a heartbeat"
    );
    assert!(matches!(rig.posts[1].1, Post::Message { to: To::One(9), class: Class::Info, .. }));
}

#[test]
fn another_node_with_the_bridge_s_id_is_reported_and_not_listed() {
    let mut rig = Rig::new(vec![Simulated::new(126, 0)]);
    rig.run_ms(5500);
    assert_eq!(rig.bridge.state.log.len(), 1);
    assert!(rig.bridge.state.log[0].contains("--node-id") && rig.bridge.nodes().is_empty());
    assert_eq!(texts(&rig.sent_messages()), ["Another node has the bridge's ID 126: --node-id"]);
}

/// The components that sent a HEARTBEAT since the last call.
fn heartbeats(rig: &mut Rig) -> BTreeSet<u8> {
    let posts = std::mem::take(&mut rig.posts);
    let component = |(_, post): (Duration, Post)| match post {
        Post::Message { out, .. } if out.key().is_some_and(|key| key.1 == 0) => Some(out.component),
        _ => None,
    };
    posts.into_iter().filter_map(component).collect()
}

const QUADROTOR: u8 = 2;
const ARDUPILOT: u8 = 3;

#[test]
fn the_bridge_sends_no_heartbeat_for_a_component_on_a_channel() {
    let mut rig = Rig::new(vec![Simulated::new(1, 3), Simulated::new(42, 3)]);
    rig.run_ms(2500);
    assert_eq!(heartbeats(&mut rig), BTreeSet::from([1, 42, 126]));
    let autopilot = Asker { from: (1, 1), ..STATION };
    rig.send_request_as(
        autopilot,
        (0, 0),
        Request::Heartbeat { kind: QUADROTOR, autopilot: ARDUPILOT },
    );
    rig.run_ms(2500);
    assert_eq!(heartbeats(&mut rig), BTreeSet::from([42, 126]));
    // Its parameters and commands are not the node's.
    rig.command(1, command::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]);
    rig.command(1, 400, &[1.0]);
    rig.list(0);
    rig.run_ms(100);
    let components: BTreeSet<u8> =
        rig.sent_messages().into_iter().map(|(component, _)| component).collect();
    assert_eq!((components, rig.nodes[0].restarts), (BTreeSet::from([42]), 0));
}

#[test]
fn a_hidden_node_has_no_heartbeat_and_the_bridge_s_component_one() {
    let mut rig = Rig::new(vec![Simulated::new(1, 0), Simulated::new(7, 0)]);
    rig.bridge.state.settings.component = 1;
    rig.bridge.state.settings.hidden.insert(NodeId::new(7).unwrap());
    rig.run_ms(2500);
    let own = |(_, post): &&(Duration, Post)| {
        matches!(
            post,
            Post::Message { out, .. } if out.key() == Some((1, 0, 0))
        )
    };
    assert_eq!(rig.posts.iter().filter(own).count(), 3);
    assert_eq!(heartbeats(&mut rig), BTreeSet::from([1]));
    let statuses = |rig: &mut Rig| {
        std::mem::take(&mut rig.posts)
            .into_iter()
            .any(|(_, post)| matches!(post, Post::Status { node, .. } if node.get() == 7))
    };
    rig.run_ms(1500);
    assert!(statuses(&mut rig), "the status must be sent nevertheless");
}

#[test]
fn heartbeats_of_other_bridges_or_our_own_hide_no_node() {
    let mut rig = Rig::with_node(0);
    let router = Asker { from: (1, 42), ..STATION };
    rig.send_request_as(router, (0, 0), Request::Heartbeat { kind: 18, autopilot: 8 });
    rig.run_ms(1500);
    assert_eq!(heartbeats(&mut rig), BTreeSet::from([42, 126]));
}

#[test]
fn two_nodes_with_one_id_are_reported_and_not_taken_for_restarts() {
    let mut rig = Rig::new(vec![Simulated::new(42, 0), Simulated::new(42, 0)]);
    rig.nodes[0].uptime_s = 500;
    rig.run_ms(20_500);
    let sent = texts(&rig.sent_messages());
    assert_eq!(sent, ["Node 42 has restarted", "Two nodes have the ID 42"]);
}

#[test]
fn repeated_restarts_are_not_taken_for_two_nodes() {
    let mut rig = Rig::with_node(0);
    for _ in 0..10 {
        rig.run_ms(3000);
        rig.node().uptime_s = 0;
    }
    rig.run_ms(1000);
    assert_eq!(texts(&rig.sent_messages()), ["Node 42 has restarted"; 10]);
}
