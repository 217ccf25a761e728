//! Receives and sends a few transfers that agree with those of pydronecan: `cargo run --example
//! golden_frames`.

use dronecan_wire::{Data, Id, Received, Receiver, Segment, Sender, Verdict, float16, types};

/// This node's ID.
const NODE: u8 = 120;

/// The actuator that this node moves.
const ACTUATOR: u8 = 2;

/// The data types that this node receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Unknown,
    ArrayCommand,
    NodeStatus,
    GetNodeInfo,
    GetSet,
}

impl Received for Kind {
    const UNKNOWN: Self = Self::Unknown;

    fn of_message(data_type: u16) -> Self {
        if data_type == types::ARRAY_COMMAND.id {
            Self::ArrayCommand
        } else if data_type == types::NODE_STATUS.id {
            Self::NodeStatus
        } else {
            Self::Unknown
        }
    }

    fn of_request(service: u8) -> Self {
        if service == types::GET_NODE_INFO.id {
            Self::GetNodeInfo
        } else if service == types::GET_SET.id {
            Self::GetSet
        } else {
            Self::Unknown
        }
    }

    fn is_request(self) -> bool {
        matches!(self, Self::GetNodeInfo | Self::GetSet)
    }

    fn is_multi_frame(self) -> bool {
        matches!(self, Self::ArrayCommand | Self::GetSet)
    }

    fn entry_len(self) -> u8 {
        if self == Self::ArrayCommand { 4 } else { 0 }
    }

    fn seed(self) -> u16 {
        match self {
            Self::ArrayCommand => types::ARRAY_COMMAND.seed,
            Self::GetSet => types::GET_SET.seed,
            _ => 0,
        }
    }
}

/// The frames that come from the bus: identifiers and data.
const RECEIVED: &[(u32, &[u8])] = &[
    // NodeStatus of node 10.
    (0x1801_550A, &[0x0A, 0, 0, 0, 0, 0, 0, 0xC1]),
    // ArrayCommand: actuator 1 to 0.5, actuator 2 to -1.0, actuator 3 to a pulse of 1500 us.
    (0x1003_F20A, &[0x12, 0xF3, 0x01, 0x00, 0x00, 0x38, 0x02, 0x88]),
    (0x1003_F20A, &[0x00, 0x00, 0xBC, 0x03, 0x04, 0xDC, 0x65, 0x68]),
    // GetNodeInfo to this node, and to another node.
    (0x1E01_F8FF, &[0xC3]),
    (0x1E01_AAFF, &[0xC3]),
    // GetSet of a parameter by its name.
    (0x1E0B_F8FF, &[0xC5, 0x16, 0x00, 0x01, 0x2A, 0x00, 0x00, 0x81]),
    (0x1E0B_F8FF, &[0x00, 0x00, 0x00, 0x00, 0x00, 0x43, 0x41, 0x21]),
    (0x1E0B_F8FF, &[0x4E, 0x5F, 0x4E, 0x4F, 0x44, 0x45, 0x41]),
];

fn main() {
    receive();
    send("NodeStatus", types::NODE_STATUS, 5, &[0x78, 0x56, 0x34, 0x12, 0x40, 0xEF, 0xBE]);
    send(
        "actuator.Status",
        types::ACTUATOR_STATUS,
        1,
        &[0x01, 0x00, 0x34, 0xFF, 0x7F, 0xFF, 0x7F, 0x7F],
    );
}

fn receive() {
    let mut receiver = Receiver::<Kind, 1, 1, 32>::new();
    for (now_ms, &(id, data)) in (0..).zip(RECEIVED) {
        let id = Id::from_bytes(id.to_be_bytes());
        print!("received {id:02X?} {data:02X?}: ");
        let segment = match Segment::read(id, data, NODE) {
            Ok(segment) => segment,
            Err(rejection) => {
                println!("dropped, {rejection:?}");
                continue;
            }
        };
        match receiver.accept(segment, ACTUATOR, now_ms) {
            Verdict::More => println!("there is more"),
            Verdict::Rejected(rejection) => println!("dropped, {rejection:?}"),
            Verdict::Message(message) => {
                print!("{:?} from node {}", message.kind, message.source);
                match *message.payload() {
                    [actuator, _, low, high] if message.kind == Kind::ArrayCommand => {
                        let thousandths =
                            i32::from(float16::to_fixed(u16::from_le_bytes([low, high]), 10))
                                * 1000
                                / 1024;
                        println!(", actuator {actuator} to {thousandths} thousandths");
                    }
                    _ => println!(),
                }
            }
            Verdict::Request(request) => println!(
                "request {:?} from node {}, transfer {}, {} bytes",
                request.kind,
                request.source,
                request.transfer_id(),
                request.len()
            ),
        }
    }
}

fn send(name: &str, message: types::Message, transfer_id: u8, payload: &[u8]) {
    let id = Id::message(24, message.id, NODE);
    let mut sender = Sender::new();
    sender.begin(payload.len() as u8, transfer_id, message.seed);
    while sender.is_busy() {
        let mut data = Data::EMPTY;
        while !sender.is_ready() {
            sender.step(payload, &mut data);
        }
        println!("{name}: send {id:02X?} {:02X?}", data.as_slice());
        sender.sent();
    }
}
