//! What each dialect makes of the rows of its table ([`table`](crate::table) describes a row): the
//! constants of its types, and `Message` with a variant for each message.
//!
//! A module that expands [`message_enum`] imports the names in the rows, and `types` and `DataType`
//! of its dialect. It chooses which of the three functions decodes a transfer.

/// Makes the constants of the types, and `KNOWN`.
macro_rules! constants {
    (
        messages { $(
            $(#[$doc:meta])* $message:ident = $message_type:expr $(=> $message_form:tt)?;
        )* }
        services { $(
            $(#[$service_doc:meta])* $service:ident = $service_type:expr $(=> $service_form:tt)?;
        )* }
        others { $($other:expr;)* }
    ) => {
        $($(#[$doc])* pub const $message: DataType = $message_type;)*
        $($(#[$service_doc])* pub const $service: DataType = $service_type;)*

        /// All types of the table.
        pub const KNOWN: &[DataType] = &[$($message,)* $($service,)* $($other,)*];
    };
}

/// Makes `Message` from the rows of a table.
macro_rules! message_enum {
    (
        messages { $(
            $(#[$type_doc:meta])*
            $name:ident = $data_type:expr
            $(=> {
                $(#[$doc:meta])*
                $message:ident $(($field:ident: $fields:ty)
                    $(by $decode:path, $encode:path, $write:path)?)?
            })?;
        )* }
        services { $(
            $(#[$service_doc:meta])*
            $service:ident = $service_type:expr
            $(=> {
                $(#[$request_doc:meta])*
                request $request:ident $(($request_field:ident: $request_fields:ty)
                    $(by $request_decode:path, $request_encode:path, $request_write:path)?)?,
                $(#[$response_doc:meta])*
                response $response:ident $(($response_field:ident: $response_fields:ty)
                    $(by $response_decode:path, $response_encode:path, $response_write:path)?)?
            })?;
        )* }
        others { $($other:expr;)* }
    ) => {
        /// A decoded transfer. `Display` gives its name and its fields: "ArrayCommand id 1 unitless
        /// +0.50", "draft.ArrayCommand id 1 +0.50".
        #[derive(Clone, Debug, PartialEq)]
        pub enum Message {
            $($($(#[$doc])* $message $(($fields))?,)?)*
            $($(
                $(#[$request_doc])* $request $(($request_fields))?,
                $(#[$response_doc])* $response $(($response_fields))?,
            )?)*
            /// A type that is not decoded, or a payload that does not fit its type: name and bytes.
            Other { name: String, payload: Vec<u8> },
        }

        impl Message {
            /// Decodes a broadcast; `None` if it does not fit its type.
            fn decode_message(data_type: &DataType, payload: &[u8]) -> Option<Message> {
                match *data_type {
                    $($(types::$name => decode!(
                        payload, $message $($fields $(; $decode)?)?
                    ),)?)*
                    _ => None,
                }
            }

            /// Decodes the request of a service.
            fn decode_request(data_type: &DataType, payload: &[u8]) -> Option<Message> {
                match *data_type {
                    $($(types::$service => decode!(
                        payload, $request $($request_fields $(; $request_decode)?)?
                    ),)?)*
                    _ => None,
                }
            }

            /// Decodes the response of a service.
            fn decode_response(data_type: &DataType, payload: &[u8]) -> Option<Message> {
                match *data_type {
                    $($(types::$service => decode!(
                        payload, $response $($response_fields $(; $response_decode)?)?
                    ),)?)*
                    _ => None,
                }
            }

            /// Type and payload; `None` for `Other`, which does not have its type.
            pub fn encode(&self) -> Option<(&'static DataType, Vec<u8>)> {
                let payload = match self {
                    $($(Message::$message $(($field))? => encode!(
                        $($field $fields $(; $encode)?)?
                    ),)?)*
                    $($(
                        Message::$request $(($request_field))? => encode!(
                            $($request_field $request_fields $(; $request_encode)?)?
                        ),
                        Message::$response $(($response_field))? => encode!(
                            $($response_field $response_fields $(; $response_encode)?)?
                        ),
                    )?)*
                    Message::Other { .. } => return None,
                };
                Some((self.data_type()?, payload))
            }

            /// The type; `None` for `Other`.
            pub fn data_type(&self) -> Option<&'static DataType> {
                match self {
                    $($(Message::$message { .. } => Some(&types::$name),)?)*
                    $($(Message::$request { .. } | Message::$response { .. } => {
                        Some(&types::$service)
                    })?)*
                    Message::Other { .. } => None,
                }
            }

            /// True for a request, false for a response of a service; `None` for a broadcast.
            pub fn is_request(&self) -> Option<bool> {
                match self {
                    $($(
                        Message::$request { .. } => Some(true),
                        Message::$response { .. } => Some(false),
                    )?)*
                    _ => None,
                }
            }

            /// Name of the type, with the direction of a service: "GetNodeInfo request".
            pub fn name(&self) -> String {
                if let Message::Other { name, .. } = self {
                    return name.clone();
                }
                let name = self.data_type().map_or("", |data_type| data_type.name);
                match self.is_request() {
                    Some(true) => format!("{name} request"),
                    Some(false) => format!("{name} response"),
                    None => name.to_owned(),
                }
            }
        }

        impl fmt::Display for Message {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{}", self.name())?;
                match self {
                    $($(Message::$message $(($field))? => write_fields!(
                        f, $($field $(; $write)?)?
                    ),)?)*
                    $($(
                        Message::$request $(($request_field))? => write_fields!(
                            f, $($request_field $(; $request_write)?)?
                        ),
                        Message::$response $(($response_field))? => write_fields!(
                            f, $($response_field $(; $response_write)?)?
                        ),
                    )?)*
                    Message::Other { payload, .. } => crate::text::write_raw(f, payload),
                }
            }
        }
    };
}

/// Decodes the payload of a variant: without fields, with those of its type, or by a function.
macro_rules! decode {
    ($payload:ident, $variant:ident) => {
        $payload.is_empty().then_some(Message::$variant)
    };
    ($payload:ident, $variant:ident $fields:ty) => {
        <$fields>::decode($payload).map(Message::$variant)
    };
    ($payload:ident, $variant:ident $fields:ty; $decode:path) => {
        $decode($payload).map(|fields| Message::$variant(fields.into()))
    };
}

/// Encodes the fields of a variant.
macro_rules! encode {
    () => {
        Vec::new()
    };
    ($field:ident $fields:ty) => {
        <$fields>::encode($field)
    };
    ($field:ident $fields:ty; $encode:path) => {
        $encode($field)
    };
}

/// Writes the fields of a variant, with a space before them.
macro_rules! write_fields {
    ($f:ident,) => {
        Ok(())
    };
    ($f:ident, $field:ident) => {
        crate::text::display($f, $field)
    };
    ($f:ident, $field:ident; $write:path) => {
        $write($f, $field)
    };
}

pub(crate) use {constants, decode, encode, message_enum, write_fields};
